"""Practice drives whose equations are not the estimator's, for tests and campaigns."""

from .car import OUTSIDE, SIZES, draw_size
from .drive import Drive, simulate

__all__ = ["OUTSIDE", "SIZES", "Drive", "draw_size", "simulate"]
