# User-mode Linux for with-vcan, which sources this file: what it lacks, whether it boots, and one run in it.
# Uses of with-vcan: here, cache, channel, say.
# shellcheck shell=bash disable=SC2154
memory=${HIL_VCAN_MEMORY:-2G}

uml_modules() { find /usr/lib/uml/modules -name modules.dep 2>/dev/null | sort -V | tail -n 1; }

# What user-mode Linux lacks here; nothing when its parts are all there
uml_lacks() {
    command -v linux.uml >/dev/null && [ -n "$(uml_modules)" ] || { echo "apt-get install user-mode-linux"; return; }
    command -v ip >/dev/null || { echo "apt-get install iproute2"; return; }
    command -v python3 >/dev/null || echo "apt-get install python3"
}

# The C compiler, as the planner looks for it; CC=none goes without
compiler() { if [ -n "${CC-}" ]; then command -v "$CC"; else command -v gcc || command -v cc; fi; }

# Path of the library built from uml_xstate.c, by the hash of source and compiler; nothing where it cannot be built
xstate_library() {
    local cc source=$here/uml_xstate.c path build
    cc=$(compiler) || return
    path=$cache/uml_xstate-$({ cat "$source"; "$cc" --version; } | sha256sum | cut -c 1-32).so
    if [ ! -f "$path" ]; then
        mkdir -p "$cache" && build=$(mktemp "$cache/uml_xstate.XXXXXX") || return
        "$cc" -O2 -shared -fPIC -o "$build" "$source" && mv "$build" "$path" || { rm -f "$build"; return; }
    fi
    echo "$path"
}

# Where the guest's memory lies: a file, in /dev/shm if that has the room (containers often give it 64 MB)
memory_folder() {
    local free
    free=$(df --output=avail -B1 /dev/shm 2>/dev/null | tail -n 1)
    if [ "${free:-0}" -ge "$(numfmt --from=iec "$memory")" ]; then echo /dev/shm; else echo /tmp; fi
}

# Why the guest stopped, from what its kernel and the program said last
uml_why() {
    if grep -q "ptrace set fp regs failed" "$1"; then
        echo "this processor has more register state (AMX) than it knows, and uml_xstate.c could not be built;" \
            "as root: apt-get install gcc libc6-dev"
    else
        grep -m 1 "Kernel panic" "$1" || grep -v '^[[:space:]]*$' "$1" | tail -n 1
    fi
}

# What the answer of a boot depends on: processor, host kernel, user-mode kernel and its modules, preloaded library
uml_identity() {
    uname -mrs
    grep -m 1 '^model name' /proc/cpuinfo
    grep -m 1 '^flags' /proc/cpuinfo
    sha256sum "$(command -v linux.uml)"
    uml_modules
    xstate_library
    cat "$here/with-vcan" "$here/vcan-uml.sh" "$here/vcan-guest.sh"
}

# Whether a guest comes up and has the channel, tried once; only a good answer is kept, the rest may pass.
# `uml_reason` says why not.
uml_boots() {
    local known
    known=$cache/uml-boots-$(uml_identity 2>/dev/null | sha256sum | cut -c 1-32)
    [ -f "$known" ] && return
    uml_reason=$( (uml test -d "/sys/class/net/$channel") 2>&1) || { uml_reason=${uml_reason##*ended: }; return 1; }
    mkdir -p "$cache" 2>/dev/null && : >"$known"
    return 0
}

# uml CMD [ARG...]: one guest, from boot to halt; returns the exit code of CMD
uml() {
    local code saved boot library terminal=''   # `guest` is global: the traps need it
    if [ -t 0 ] && [ -t 1 ]; then terminal=yes; fi
    guest=$(mktemp -d /tmp/with-vcan.XXXXXX) || return 2
    trap 'rm -rf "$guest"' EXIT
    export -p >"$guest/environment"
    {
        printf 'directory=%q modules=%q channel=%q guest=%q\n' "$PWD" "$(uml_modules)" "$channel" "$guest"
        printf 'terminal=%q\ncommand=(' "$terminal"
        printf ' %q' "$@"
        echo ')'
        cat "$here/vcan-guest.sh"
    } >"$guest/init"
    boot=(env "TMPDIR=$(memory_folder)")
    library=$(xstate_library)
    # by a link: LD_PRELOAD is split at blanks and colons
    [ -z "$library" ] || { ln -s "$library" "$guest/xstate.so"; boot+=("LD_PRELOAD=$guest/xstate.so"); }
    # earlyprintk keep_bootcon quiet: errors of the guest's kernel go to the log
    boot+=(linux.uml "mem=$memory" rootfstype=hostfs rootflags=/ rw init=/bin/bash con=null con0=null
        ssl1="null,fd:6" panic=-1 quiet earlyprintk keep_bootcon "uml_dir=$guest/")
    if [ -n "$terminal" ]; then
        saved=$(stty -g)
        "${boot[@]}" ssl0="fd:7,fd:5" -- "$guest/init" 5>&1 6>&2 7<&0 >"$guest/log" 2>&1
        stty "$saved"
    else
        trap 'kill -TERM $! 2>/dev/null; rm -rf "$guest"; exit 130' INT TERM
        "${boot[@]}" ssl0="null,fd:5" -- "$guest/init" 5>&1 6>&2 >"$guest/log" 2>&1 </dev/null &
        wait $! 2>/dev/null # what bash has to say of an abort is in the log
    fi
    code=$(cat "$guest/code" 2>/dev/null)
    [ -n "$code" ] && return "$code"
    say "user-mode Linux stopped before the command ended: $(uml_why "$guest/log")"
    return 2
}
