"""Types of numbers in bulk, declared once: numpy arrays, and symbolic expressions of CasADi."""

from __future__ import annotations

from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Real numbers; shape and unit stand where it is used."""
Ints = NDArray[np.int64]
"""Indices and counts."""
Bools = NDArray[np.bool_]
"""Which of the others are meant."""
Complex = NDArray[np.complex128]
Expr = Any
"""CasADi SX, MX or DM, or a float where a function serves numbers as well: CasADi ships no types for its operators."""


def finite(*arrays: Array) -> bool:
    """Whether all are numbers, whose sum is one, too."""
    return isfinite(sum([float(np.add.reduce(array, axis=None)) for array in arrays]))
