"""Write one drive as CSV."""

from __future__ import annotations

import argparse
from pathlib import Path

from .drive import simulate


def main() -> None:
    """Write one drive as CSV."""
    parser = argparse.ArgumentParser(description="Write one practice drive.")
    parser.add_argument("out", type=Path)
    parser.add_argument("--effect", action="append", default=[], metavar="NAME=SIZE")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    effects = {name: float(size) for name, size in (item.split("=") for item in arguments.effect)}
    simulate([effects], [arguments.seed])[0].write(arguments.out)


if __name__ == "__main__":
    main()
