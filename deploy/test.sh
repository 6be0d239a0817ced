#!/bin/bash
# deploy/test.sh [PYTEST ARGS]: every check CI runs; ends with a plain summary. Needs no root, but as root it
# installs the system packages that the vcan and browser tests want. The tracked files stay as they are: what a run
# leaves goes to a folder that is removed at the end, or stays where HIL_RESULTS names one. Where no vcan interface can
# be had, the tests that need one are listed with the reason; with HIL_REQUIRE_VCAN=1 that is a failure.
set -uo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
cd "$root" || exit
"$root/deploy/setup.sh" || exit 1
if [ -n "${HIL_RESULTS-}" ]; then
    mkdir -p "$HIL_RESULTS" && results=$(cd "$HIL_RESULTS" && pwd) || exit 2
    [ -z "$(ls -A "$results")" ] || { echo "HIL_RESULTS=$HIL_RESULTS: holds files already; name an empty folder" >&2; exit 2; }
else
    results=$(mktemp -d)
    trap 'rm -rf "$results"' EXIT
fi
export PATH="$root/.venv/bin:$PATH" OMP_NUM_THREADS=1 HIL_PROMISE_FIGURES="$results/figures"
export XDG_CACHE_HOME="$results/cache"    # a new user's: empty
# Hundreds of processes are started: where byte code may not be kept beside the modules, each would compile them all.
unset PYTHONDONTWRITEBYTECODE
export PYTHONPYCACHEPREFIX="$results/bytecode"
started=$SECONDS

# step NAME CMD...: output goes to a file and is shown only when CMD fails; the result is a line of the summary
step() {
    local name=$1 from=$SECONDS verdict=ok; shift
    "$@" >"$results/$name.log" 2>&1 || verdict=FAILED
    printf '%-24s %-6s %4d s\n' "$name" "$verdict" "$((SECONDS - from))" | tee -a "$results/steps" >&2
    [ "$verdict" = ok ] || { tail -n 60 "$results/$name.log" >&2; echo "$name" >>"$results/failed"; }
}

# `hil doctor --packages` prints what is missing here, by Debian package name; tests that need it are skipped without
missing=$(hil doctor --packages)
if [ -n "$missing" ] && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    echo "installing $missing" >&2
    export DEBIAN_FRONTEND=noninteractive
    # shellcheck disable=SC2086
    { apt-get update -qq && apt-get install -y -qq --no-install-recommends $missing; } >"$results/apt.log" 2>&1
    missing=$(hil doctor --packages)
    [ -z "$missing" ] || tail -n 1 "$results/apt.log" >&2
fi
[ -z "$missing" ] || echo "missing, some tests are skipped: apt-get install $missing" >&2

export HIL_MADE_ONCE="$XDG_CACHE_HOME/made"    # what several tests share
# What fails is run again alone, to tell a machine that was busy from a defect; it has failed all the same, unless
# tests/second_try.toml names it with the reason that was measured (deploy/summary.py).
tests() {
    local name=$1; shift
    "$@" --junitxml="$results/$name.xml" && return
    "$@" -n 0 --last-failed --last-failed-no-failures none --junitxml="$results/$name-alone.xml"
    python deploy/summary.py "$results" "$name"
}
# Two processors: the tests on vcan, in a guest with one processor, run beside what is no test.
on_vcan() {
    if deploy/with-vcan --which >"$results/vcan-kind" 2>"$results/vcan.log"; then
        step vcan-tests tests vcan deploy/with-vcan python -m pytest -m vcan tests/vcan "$@"
    else
        echo "vcan tests not run: $(tail -n 1 "$results/vcan.log")" >&2
        [ "${HIL_REQUIRE_VCAN:-0}" != 1 ] || echo vcan-tests >>"$results/failed"
    fi
}
# What every loop of the demo's settings needs, so that no test waits for another one to compile it
compiled() { python -c 'from hil_gateway.config import Config; from planner.simulation.loop import Loop; Loop(Config())'; }
echo "all of it: about a quarter of an hour" >&2
step ruff ruff check .
{ on_vcan "$@"; [ $# != 0 ] || step functions compiled; } &
step mypy mypy
[ $# != 0 ] || step drives env PYTHONPATH=tests python tests/support/drives/practice_drives.py "$HIL_MADE_ONCE"
wait
crowd="not vcan"
if [ $# = 0 ]; then
    step quiet-tests tests quiet python -m pytest -m quiet tests/faults
    crowd="not vcan and not quiet"
fi
step tests tests normal python -m pytest -n 2 --dist worksteal -m "$crowd" "$@"
step promises hil verify --from "$HIL_PROMISE_FIGURES" --page "$results/promises.md"
# A figure missed on a busy machine is shown, it does not fail the run; nor do figures take it past its time.
for benchmark in codec gateway loop recorder identify planner; do
    [ "$((SECONDS - started))" -lt 780 ] || { echo "benchmark $benchmark: left out, time is up" >&2; continue; }
    echo "benchmark $benchmark" >&2
    timeout 60 python -m "benchmarks.$benchmark" >"$results/benchmark" 2>&1 || echo "    figure missed or not done" >&2
    tail -n 6 "$results/benchmark" >&2
done

echo "total $((SECONDS - started)) s" >&2
python deploy/summary.py "$results"
