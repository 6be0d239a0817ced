"""Practice drives whose equations are not the estimator's."""

from .car import OUTSIDE, SIZES, draw_size
from .drive import LAPS, Drive, simulate
from .outside import COLUMNS

__all__ = ["COLUMNS", "LAPS", "OUTSIDE", "SIZES", "Drive", "draw_size", "simulate"]
