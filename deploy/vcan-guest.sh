# Process 1 of user-mode Linux, appended by with-vcan to the settings of one run: directory, modules, channel,
# guest, terminal, command. Its last act is to write down the exit code and to halt the machine.
# shellcheck shell=bash disable=SC2154,SC1091
mount -t proc proc /proc
mount -t sysfs sysfs /sys
mount -t tmpfs tmpfs /run
mkdir -p /run/netns
mountpoint -q /dev || mount -t devtmpfs devtmpfs /dev
[ -c /dev/null ] && [ -c /dev/ttyS0 ] || mount -t devtmpfs devtmpfs /dev
mkdir -p /dev/shm /dev/pts
mount -t tmpfs tmpfs /dev/shm
mount -t devpts devpts /dev/pts
ln -sfn /proc/self/fd /dev/fd
stty -F /dev/ttyS0 raw -echo
stty -F /dev/ttyS1 raw -echo
. "$guest/environment"

# Loads modules with what they depend on; modprobe would want them under /lib/modules.
python3 - "$modules" can can-raw can-bcm can-gw vcan vxcan veth sch_netem <<'PYTHON'
import ctypes, pathlib, sys
index = pathlib.Path(sys.argv[1])
needs = {name.strip(): rest.split() for name, _, rest in (line.partition(":") for line in index.read_text().splitlines())}
stem = lambda path: pathlib.Path(path).name.partition(".")[0].replace("_", "-")
libc = ctypes.CDLL(None)
FINIT_MODULE = 313  # x86-64
for wanted in sys.argv[2:]:
    for path in (p for p in needs if stem(p) == wanted.replace("_", "-")):
        for part in [*reversed(needs[path]), path]:
            with open(index.parent / part, "rb") as file:
                libc.syscall(FINIT_MODULE, file.fileno(), b"", 0)  # already loaded: no harm
PYTHON
ip link set lo up
ip link set lo multicast on
ip link add "$channel" type vcan
ip link set "$channel" up

cd "$directory" || exit
if [ "$terminal" = yes ]; then
    stty -F /dev/ttyS0 sane
    setsid --ctty --wait "${command[@]}" <>/dev/ttyS0 >&0 2>&1
    code=$?
else
    # through pipes, so that the command sees no terminal; something it left in the background may still hold them
    mkfifo /run/out /run/err
    cat /run/out >/dev/ttyS0 &
    cat /run/err >/dev/ttyS1 &
    "${command[@]}" </dev/null >/run/out 2>/run/err
    code=$?
    for _ in 1 2 3 4 5 6 7 8 9 10; do
        [ -z "$(jobs -r)" ] && break
        sleep 0.1
    done
fi
stty -F /dev/ttyS0 >/dev/null # waits until the last output has been written
echo "$code" >"$guest/code"
sync
echo o >/proc/sysrq-trigger
sleep 5
