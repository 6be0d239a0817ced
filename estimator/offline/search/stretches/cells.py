"""Grip that differs on a stretch of the track in certain laps: water, oil, gravel, a shower that dries.

Neither a function of the place nor one of time, and no effect of the catalogue. Every cell, some metres of one lap,
has a gain by which the model would predict better if the grip of both axles were another one there. The rectangle of
places and laps with the largest gain for one change of grip is the candidate: for given places the laps are those with
the largest quotient of gradient and curvature (linear-time subset scan; Neill, J. R. Stat. Soc. B 74, 2012).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from estimator.model.effect import Effect, Hook
from estimator.model.parameters import Parameter
from estimator.model.single_track import Terms
from estimator.offline.fit.normal import accumulate
from estimator.offline.fit.prediction_error import Fit, Point
from estimator.offline.predict.places import LATERAL, PLACES
from estimator.offline.predict.predict import Predictor
from estimator.offline.record.noise import ResidualNoise
from estimator.offline.record.record import Record
from estimator.offline.record.road import LEAST_LAPS
from estimator.offline.record.window_columns import WindowBasis
from hil_gateway.process.arrays import Array, Expr, Ints

CELL_M, FEWEST_CELLS, MOST_CELLS = 10.0, 8, 400
"""m of track position a cell, which a car passes in a few blocks; most cells of a lap"""
LONGEST_SHARE = 0.4
"""of a lap: what covers more of it in some laps acts over time"""
GRIP_STD = 0.3
"""Prior standard deviation of the relative change: a wet road has about 0.7 of the grip of a dry one."""
TELLS = 3.0
"""A lap says whether it has the other grip where that would be so many of its own standard errors."""
MOST = 0.5
"""Share of what is left in the lateral channels that a stretch must hold to be named as its cause."""
PIECES = 4
"""of a stretch, whose errors are taken as independent: some seconds each"""


def _stiffness_kept(terms: Terms, change: Expr) -> None:
    PLACES["grip"].hook(terms, change)
    terms.slip_f, terms.slip_r = terms.slip_f / (1 + change), terms.slip_r / (1 + change)


FORMS: tuple[Hook, ...] = (PLACES["grip"].hook, _stiffness_kept)
"""Water takes from the peak D of a tyre, and from its cornering stiffness B C D as much or nothing."""


def effect_of(name: str, hook: Hook, prior: tuple[float, float] = (0.0, GRIP_STD)) -> Effect:
    """Another grip of both axles in proportion to the profile of this name; `prior` is mean and deviation."""
    change = Parameter("change", "1", *prior, -0.9, 1.0, "of the grip of both axles, relative")
    return Effect(
        name=name,
        lacks="empirical: another grip of both axles on a stretch",
        equation="D_i = D_0,i (1 + x) from s = a to b in certain laps",
        source="empirical, fitted to this data",
        parameters=(change,),
        channels=LATERAL,
        cause="track_position",
        hooks={"GRIP": hook},
        profile=name,
    )


@dataclass(frozen=True)
class Stretch:
    """Places (m) and laps, by their number in the log, with another grip.

    `every_lap`: all laps learnt from that can tell have it, so that it belongs to the track, in other laps as well.
    """

    start: float
    end: float
    laps: tuple[int, ...]
    every_lap: bool

    def covers(self, record: Record) -> Array:
        """(n,) 1 for rows with the other grip, else 0."""
        position = record.signals["track_position"]
        inside = (position >= self.start) & (position < self.end)
        return (inside & (self.every_lap | np.isin(record.lap_of_row, self.laps))).astype(np.float64)


NOWHERE = Stretch(0.0, 0.0, (), every_lap=False)


@dataclass(frozen=True)
class Candidate:
    """A stretch by a linearisation: its form, gain (natural log), and change of grip with standard deviation.

    `longest`: a longer one is not sought, so that it may be part of what acts over time.
    """

    stretch: Stretch
    hook: Hook
    gain: float
    change: float
    std: float
    longest: bool = False


@dataclass(frozen=True)
class Cells:
    """What the cells say of a change of grip: gradient (laps, m) and curvature (laps, m, m) of the log-likelihood.

    `edges` (m + 1,) of the cells, m; `laps` (laps,) their number in the log; `hook` is the form of the change.
    """

    edges: Array
    laps: Ints
    gradient: Array
    curvature: Array
    hook: Hook

    def most_gaining(self) -> Candidate:
        """The stretch with the largest gain for one change of grip."""
        starts, stops = np.triu_indices(len(self.edges), 1)
        short = self.edges[stops] - self.edges[starts] <= LONGEST_SHARE * self.edges[-1]
        starts, stops = starts[short], stops[short]
        pull, weight = self._sums(starts, stops)
        gain, at, chosen = max((_best_laps(sign * pull, weight) for sign in (-1.0, 1.0)), key=lambda best: best[0])
        return self._candidate(int(starts[at]), int(stops[at]), chosen, gain)

    def _sums(self, starts: Ints, stops: Ints) -> tuple[Array, Array]:
        """Gradient and curvature (laps, n) of the cells from `starts` to `stops` (n,), by their cumulative sums."""
        pull = np.pad(np.cumsum(self.gradient, axis=1), ((0, 0), (1, 0)))
        square = np.pad(self.curvature.cumsum(axis=1).cumsum(axis=2), ((0, 0), (1, 0), (1, 0)))
        crossed = square[:, starts, stops] + square[:, stops, starts]
        weight = square[:, stops, stops] + square[:, starts, starts] - crossed
        return pull[:, stops] - pull[:, starts], np.maximum(weight, 0.0)

    def _candidate(self, a: int, b: int, chosen: Ints, gain: float) -> Candidate:
        """The cells from `a` to `b` in the `chosen` laps; every lap where no other could have told."""
        pull, weight = (sums[:, 0] for sums in self._sums(np.array([a]), np.array([b])))
        precision = float(weight[chosen].sum()) + GRIP_STD**-2
        change = float(pull[chosen].sum()) / precision
        others = np.setdiff1d(np.arange(len(self.laps)), chosen)
        telling = change**2 * weight > TELLS**2
        every = not telling[others].any() and np.count_nonzero(telling[chosen]) >= LEAST_LAPS
        laps = tuple(sorted(int(lap) for lap in self.laps[chosen]))
        stretch = Stretch(float(self.edges[a]), float(self.edges[b]), laps, bool(every))
        std = max(precision**-0.5, self._scatter(range(a, b), chosen, change) / precision)
        longest = self.edges[b] - self.edges[a] + self.edges[1] > LONGEST_SHARE * self.edges[-1]
        return Candidate(stretch, self.hook, gain, change, std, longest=bool(longest))

    def _scatter(self, inside: range, chosen: Ints, change: float) -> float:
        """Deviation of the sum of the scores at the change found, by parts of the stretch of every lap: a residual of
        seconds is not so many samples."""
        pieces = [part for part in np.array_split(np.array(inside), PIECES) if len(part)]
        each = [
            self.gradient[lap, part].sum() - change * self.curvature[lap][np.ix_(part, np.array(inside))].sum()
            for lap in chosen for part in pieces
        ]  # fmt: skip
        return float(np.sqrt(np.sum(np.square(each)) * len(each) / max(len(each) - 1, 1)))


def _best_laps(pull: Array, weight: Array) -> tuple[float, int, Ints]:
    """Largest gain for a positive change, of which column of (laps, n), and with which laps."""
    by_size = np.argsort(-pull / (weight + 1.0), axis=0)
    pulls = np.cumsum(np.take_along_axis(pull, by_size, axis=0), axis=0)
    weights = np.cumsum(np.take_along_axis(weight, by_size, axis=0), axis=0)
    gains = 0.5 * np.maximum(pulls, 0.0) ** 2 / (weights + GRIP_STD**-2)
    most, at = np.unravel_index(int(np.argmax(gains)), gains.shape)
    return float(gains[most, at]), int(at), by_size[: most + 1, at]


def cells(predictor: Predictor, parameters: Array, noise: ResidualNoise, variance: Array, hook: Hook) -> Cells:
    """What every cell of the record says of a change of grip of this form, around a model and its parameters.

    `variance` (5,) of the residuals. Forces do not follow a change in proportion: the step is that to a wet road.
    """
    record, model = predictor.record, predictor.model
    point = Point.at(predictor, parameters, noise)
    unit = replace(effect_of("unit", hook), profile="")
    wide = Predictor(replace(model, effects=(*model.effects, unit)), record)
    dry, wet = (wide.predict(np.insert(parameters, wide.blocks[-1].parameters.start, x)) for x in (0.0, -GRIP_STD))
    count = int(np.clip(round(record.lap_length / (CELL_M * record.size)), FEWEST_CELLS, MOST_CELLS))
    edges = np.linspace(0.0, record.lap_length, count + 1)
    place = np.searchsorted(edges, record.thin(record.signals["track_position"]).ravel(), side="right") - 1
    box = np.eye(count)[np.clip(place, 0, count - 1)]
    columns = WindowBasis.of(box, record.windows).times((dry - wet).transpose(2, 1, 0) / GRIP_STD)
    laps, number = np.unique(record.window_laps, return_inverse=True)
    _, gradient, curvature = accumulate(point.left.error, point.left.sensitivity(columns), number.astype(np.int64))
    weight = np.where(record.used, 1.0 / variance, 0.0)
    sums = np.einsum("clp,c->lp", gradient, weight), np.einsum("clpq,c->lpq", curvature, weight)
    return Cells(edges, laps, *sums, hook)


def most_gaining(predictor: Predictor, parameters: Array, noise: ResidualNoise, variance: Array) -> Candidate:
    """The stretch that gains most, in the form that does."""
    each = [cells(predictor, parameters, noise, variance, hook).most_gaining() for hook in FORMS]
    return max(each, key=lambda one: one.gain)


def around(fit: Fit) -> Candidate:
    """The stretch that gains most around a fit."""
    return most_gaining(fit.predictor, fit.parameters, fit.noise, fit.normal.variance)
