"""Where results that cost time are kept between runs."""

from __future__ import annotations

import os
from pathlib import Path


def cache_directory() -> Path:
    """$XDG_CACHE_HOME/hil-gateway, by default ~/.cache/hil-gateway."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hil-gateway"
