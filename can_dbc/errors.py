"""What a car folder can have wrong: one line that names file, key, value, limit and remedy."""

from __future__ import annotations


class PlatformError(ValueError):
    """A car folder that is missing, damaged or contradicts itself."""
