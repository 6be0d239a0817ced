"""A model over the windows of a record: predictions of the five channels and their derivatives by every parameter.

Parameters are ordered: tyre, then each effect's. A profile contributes its spline coefficients; a parameter of
an effect with memory is differentiated numerically through the past.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from estimator.model.effect import Effect
from estimator.model.parameters import Parameter
from estimator.model.single_track import CHANNELS, SingleTrack
from estimator.offline.predict.compiled_windows import arrange
from estimator.offline.predict.expressions import STATES, ModelExpressions, functions_of, memory_names
from estimator.offline.record.record import LATERAL_ROWS, Record
from estimator.offline.record.window_columns import WindowBasis, WindowColumns
from hil_gateway.process.arrays import Array


@dataclass(frozen=True)
class Block:
    """One effect's place in the parameter vector."""

    effect: Effect
    parameters: slice


class Predictor:
    """Predictions of one model on one record."""

    def __init__(self, model: SingleTrack, record: Record) -> None:
        """Nothing is evaluated yet; the symbolic functions are built on first use."""
        self.model, self.record = model, record
        start = len(model.tyre_table)
        blocks = []
        for effect in model.effects:
            size = record.bases[effect.profile].size if effect.profile else len(effect.parameters)
            blocks.append(Block(effect, slice(start, start + size)))
            start += size
        self.blocks, self.size = tuple(blocks), start

    def __reduce__(self) -> tuple[type[Predictor], tuple[SingleTrack, Record]]:
        """Another process has its own symbolic functions."""
        return Predictor, (self.model, self.record)

    @cached_property
    def table(self) -> tuple[Parameter, ...]:
        """One entry a parameter; the coefficients of a profile share theirs."""
        rows: list[Parameter] = list(self.model.tyre_table)
        for block in self.blocks:
            effect = block.effect
            size = block.parameters.stop - block.parameters.start
            rows.extend(effect.parameters * size if effect.profile else effect.parameters)
        return tuple(rows)

    def start(self, tyre: Sequence[float]) -> Array:
        """Start of a fit: given tyre parameters, each effect at its own start."""
        values = [*tyre]
        for block in self.blocks:
            size = block.parameters.stop - block.parameters.start
            known = self.record.road.get(block.effect.name)
            start = block.effect.start() * (size if block.effect.profile else 1)
            values.extend(start if known is None else known.coefficients)
        return np.array(values)

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bound of every parameter (p,).

        An effect whose neutral value is a stationary point is kept a little off it: a fit could never leave it again.
        """
        lower, upper = (np.array([getattr(p, side) for p in self.table]) for side in ("lower", "upper"))
        for block in self.blocks:
            if block.effect.initial and not block.effect.prepare:
                prior, start = np.array(block.effect.neutral()), np.array(block.effect.initial)
                own, off = lower[block.parameters], prior + OFF_NEUTRAL * (start - prior)
                own[own == prior] = off[own == prior]
        return lower, upper

    @cached_property
    def prior(self) -> Array:
        """(p,) mean of the prior: the parameter table's, and the road as kinematics show it."""
        prior = np.array([p.prior for p in self.table])
        for block in self.blocks:
            if block.effect.name in self.record.road:
                prior[block.parameters] = self.record.road[block.effect.name].coefficients
        return prior

    @cached_property
    def prior_precision(self) -> Array:
        """(p, p) weak prior from the parameter table; smoothness for profiles; what is known of the road."""
        precision = np.diag([1.0 / p.prior_std**2 for p in self.table])
        for block in self.blocks:
            if block.effect.profile:
                std = block.effect.parameters[0].prior_std
                precision[block.parameters, block.parameters] = self.record.bases[block.effect.profile].precision(std)
            if block.effect.name in self.record.road:
                precision[block.parameters, block.parameters] = self.record.road[block.effect.name].precision
        return precision

    @cached_property
    def _functions(self) -> ModelExpressions:
        return functions_of(self.model)

    @property
    def _profiles(self) -> tuple[Block, ...]:
        return tuple(b for b in self.blocks if b.effect.profile)

    @property
    def _memory(self) -> tuple[Block, ...]:
        return tuple(b for b in self.blocks if b.effect.prepare)

    @property
    def _points(self) -> list[int]:
        return [i for b in self.blocks if not b.effect.profile for i in range(b.parameters.start, b.parameters.stop)]

    @property
    def _unseen(self) -> list[int]:
        """Tyre parameters that stay at their prior: lateral ones where nothing lateral is measured.

        The forward motion alone would bend them until the drag of the front tyres stands in for what the model lacks.
        """
        lateral = self.record.used[LATERAL_ROWS].any()
        return [i for i, p in enumerate(self.model.tyre_table) if not lateral and p.name != "cx"]

    def inputs(self, parameters: Array) -> Array:
        """(k, windows * blocks) everything the model is evaluated at, states first."""
        profiles = [self._basis(b).at(parameters[b.parameters])[None] for b in self._profiles]
        return np.concatenate([self.record.inputs, self._remembered(parameters), *profiles])

    def _remembered(self, parameters: Array) -> Array:
        """(m, windows * blocks) what the effects with memory make of the past."""
        effects = [(block.effect, tuple(parameters[block.parameters].tolist())) for block in self._memory]
        windows, blocks = self.record.rows.shape[:2]
        return self.record.past(effects, memory_names(self.model)).reshape(-1, windows * blocks)

    def _theta(self, parameters: Array) -> Array:
        return parameters[[*range(len(self.model.tyre_table)), *self._points]]

    def at_inputs(self, inputs: Array, parameters: Array) -> Array:
        """(5, n) predictions at given `inputs` (k, n)."""
        return self._functions.values(inputs, self._theta(parameters))

    def predict(self, parameters: Array) -> Array:
        """(5, windows, blocks) predictions, motion channels as derivatives."""
        return self.at_inputs(self.inputs(parameters), parameters).reshape(5, *self.record.rows.shape[:2])

    def linearise_motion(self, parameters: Array) -> tuple[Array, Array]:
        """Predictions (5, windows, blocks) and their derivatives by the states (5, 3, windows, blocks)."""
        out = self._functions.by_states(self.inputs(parameters), self._theta(parameters))
        c, shape = len(CHANNELS), self.record.rows.shape[:2]
        return out[:c].reshape(c, *shape), out[c:].reshape(STATES, c, *shape).swapaxes(0, 1)

    def linearise(self, parameters: Array) -> tuple[Array, Array, WindowColumns]:
        """The same, and the derivatives by the parameters."""
        inputs = self.inputs(parameters)
        out = self._functions.derivatives(inputs, self._theta(parameters))
        c, shape = len(CHANNELS), self.record.rows.shape[:2]
        values, by = out[:c].reshape(c, *shape), out[c:].reshape(-1, c, *shape)
        points = [*range(len(self.model.tyre_table)), *self._points]
        ends = STATES + len(points), STATES + len(points) + len(self._profiles)
        by_points, by_profiles, by_past = by[STATES : ends[0]], by[ends[0] : ends[1]], by[ends[1] :]
        if self._memory:
            self._add_past(parameters, inputs, by_past, points, by_points)
        by_points[self._unseen] = 0.0
        return values, by[:STATES].swapaxes(0, 1), self._columns(points, by_points, by_profiles)

    def _add_past(
        self, parameters: Array, inputs: Array, by_past: Array, points: Sequence[int], by_points: Array
    ) -> None:
        """Add to the derivatives by parameters at `points` what these do through the past, by the chain rule."""
        at = len(self.record.inputs)
        here = inputs[at : at + len(by_past)]
        for i in (i for b in self._memory for i in range(b.parameters.start, b.parameters.stop)):
            step = MEMORY_STEP * self.table[i].prior_std
            change = (self._remembered(parameters + step * np.eye(self.size)[i]) - here) / step
            by_points[points.index(i)] += np.einsum("mcwb,mwb->cwb", by_past, change.reshape(-1, *by_past.shape[2:]))

    def _columns(self, points: Sequence[int], by_points: Array, by_profiles: Array) -> WindowColumns:
        """Derivatives from those by parameters at `points` and by the values of profiles, (k, 5, windows, blocks)."""
        own = [self._basis(b).times(u.transpose(2, 1, 0)) for b, u in zip(self._profiles, by_profiles, strict=True)]
        first = [0, len(points), *(len(points) + n for n in np.cumsum([o.values.shape[3] for o in own]))]
        windows, blocks = self.record.rows.shape[:2]
        values = np.empty((blocks, windows, len(CHANNELS), first[-1]))
        parameters = np.empty((windows, first[-1]), np.int64)
        arrange(by_points, values)
        parameters[:, : len(points)] = points
        for block, columns, start in zip(self._profiles, own, first[1:], strict=False):
            place = slice(start, start + columns.values.shape[3])
            values[..., place], parameters[:, place] = columns.values, block.parameters.start + columns.parameters
        return WindowColumns(values, parameters, self.size)

    def _basis(self, block: Block) -> WindowBasis:
        return self.record.basis_over_windows(block.effect.profile)


OFF_NEUTRAL = 0.1
"""Share of its start that an effect keeps whose neutral value, at its lower bound, is a stationary point."""
MEMORY_STEP = 0.02
"""Step of the numerical derivative through the past, in prior standard deviations."""
