#!/bin/bash
# Makes .venv from requirements.lock, every package checked against its hash; does nothing when that is done already.
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
venv=$root/.venv
stamp=$venv/installed-from
log=$(mktemp)
trap 'rm -f "$log"' EXIT

fail() { echo "set-up failed: $*" >&2; exit 1; }
say() { echo "set-up: $*" >&2; }

# run WHAT CMD...: quiet; on failure one line with the last thing CMD said
run() {
    local what=$1; shift
    say "$what"
    "$@" >"$log" 2>&1 || fail "$what: $(grep -v '^[[:space:]]*$' "$log" | tail -n 1)"
}

wanted=$(cat "$root/requirements.lock" "$root/pyproject.toml" <(echo "$root") | sha256sum)
if [ -x "$venv/bin/hil" ] && [ "$(cat "$stamp" 2>/dev/null)" = "$wanted" ]; then exit 0; fi

# An interpreter that every locked package has a wheel for; nothing when there is none
find_python() {
    local name
    for name in python3.11 python3.12 python3.13 python3; do
        if "$name" -c 'import sys; raise SystemExit(not (3, 11) <= sys.version_info < (3, 14))' 2>/dev/null; then
            echo "$name"
            return
        fi
    done
}

cd "$root"
# The lock names every package: with --no-deps nothing is resolved here, so nothing newer without a hash can be wanted.
python=$(find_python)
rm -rf "$venv"
if command -v uv >/dev/null && uv --version >/dev/null 2>&1; then
    run "creating .venv with uv" uv venv --quiet --python "${python:-3.11}" "$venv"
    run "installing packages (first time: a minute or two)" \
        uv pip install --python "$venv/bin/python" --no-deps --require-hashes -r requirements.lock
    run "installing the project" uv pip install --python "$venv/bin/python" --no-deps --no-build-isolation -e .
else
    if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null && ! "${python:-false}" -c 'import ensurepip' 2>/dev/null; then
        run "installing python3-venv" sh -c 'apt-get update -qq && apt-get install -y -qq python3-venv'
        python=$(find_python)
    fi
    [ -n "$python" ] || fail "needs Python 3.11 or newer; on Debian 12: apt-get install python3 python3-venv"
    "$python" -c 'import ensurepip' 2>/dev/null || fail "$python has no venv module; apt-get install python3-venv, or install uv"
    run "creating .venv with $python" "$python" -m venv "$venv"
    run "installing packages (first time: a minute or two)" \
        "$venv/bin/python" -m pip install -q --disable-pip-version-check --no-deps --require-hashes -r requirements.lock
    run "installing the project" \
        "$venv/bin/python" -m pip install -q --disable-pip-version-check --no-deps --no-build-isolation -e .
fi
echo "$wanted" >"$stamp"
say "done"
