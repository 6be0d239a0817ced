"""Columns of a linearised model, window by window: only those of the parameters that act in it.

A profile is local: of fifty coefficients over the lap a window of 2 s sees six.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil_gateway.process.arrays import Array, Ints


@dataclass(frozen=True)
class WindowColumns:
    """Derivatives of the five channels by the parameters.

    Attributes:
        values: (blocks, windows, 5, c).
        parameters: (windows, c) parameter that each column is of; those of one window differ.
        size: number of all parameters.
    """

    values: Array
    parameters: Ints
    size: int

    @property
    def dense(self) -> Array:
        """(5, size, windows, blocks) with a column for every parameter."""
        blocks, windows = self.values.shape[:2]
        out = np.zeros((windows, self.size, 5, blocks))
        out[np.arange(windows)[:, None], self.parameters] = self.values.transpose(1, 3, 2, 0)
        return out.transpose(2, 1, 0, 3)

    def times(self, signal: Array) -> Array:
        """(size,) sums of every parameter's derivatives times a `signal` (5, windows, blocks)."""
        products = np.einsum("bwkc,kwb->wc", self.values, signal, optimize=True)
        return np.bincount(self.parameters.ravel(), products.ravel(), self.size).astype(np.float64)

    def split(self, size: int) -> tuple[WindowColumns, WindowColumns]:
        """Those of the first `size` parameters and of the others, which are points and no profiles."""
        first = self.parameters[0] < size
        own, rest = self.values[..., first], self.values[..., ~first]
        others = self.parameters[:, ~first] - size
        return WindowColumns(own, self.parameters[:, first], size), WindowColumns(rest, others, self.size - size)

    def joined_with(self, other: WindowColumns) -> WindowColumns:
        """These and, numbered after them, those of `other`."""
        values = np.concatenate([self.values, other.values], axis=3)
        parameters = np.concatenate([self.parameters, self.size + other.parameters], axis=1)
        return WindowColumns(values, parameters, self.size + other.size)


@dataclass(frozen=True)
class WindowBasis:
    """A basis over the windows of a record, of each window only the coefficients that act in it.

    Attributes:
        values: (blocks, windows, m) of the basis; coefficients: (windows, m) which they are; size: number of all.
    """

    values: Array
    coefficients: Ints
    size: int

    @classmethod
    def of(cls, matrix: Array, windows: int) -> WindowBasis:
        """From the (windows * blocks, size) `matrix` of the basis."""
        by_window = matrix.reshape(windows, -1, matrix.shape[1])
        acts = np.any(by_window != 0.0, axis=1)
        most = int(acts.sum(axis=1).max())
        coefficients = np.argsort(~acts, axis=1, kind="stable")[:, :most]
        values = np.take_along_axis(by_window, coefficients[:, None, :], axis=2)
        return cls(np.ascontiguousarray(values.swapaxes(0, 1)), coefficients, matrix.shape[1])

    def at(self, coefficients: Array) -> Array:
        """(windows * blocks,) values of the function with these coefficients (size,)."""
        return np.asarray((self.values * coefficients[self.coefficients]).sum(axis=2).T.ravel())

    def times(self, unit: Array) -> WindowColumns:
        """Derivatives by the coefficients from those (blocks, windows, 5) by the value of the function."""
        return WindowColumns(unit[..., None] * self.values[:, :, None, :], self.coefficients, self.size)
