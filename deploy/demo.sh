#!/bin/bash
# deploy/demo.sh [ARGS]: installs into .venv if need be, then drives the simulated car: `hil demo ARGS`.
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
"$root/deploy/setup.sh"
exec "$root/.venv/bin/hil" demo "$@"
