"""What the estimator would believe of a model, had it had its effects from the first of the laps on.

The diagnosis says which effects there are; how large they and the tyres are is said by the same belief that goes on
while driving, from the same start. A fit to every channel of the log follows what no effect explains further than the
declared data allow: on the race car it gave up most of the downforce, and the car got slower in fast bends.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from estimator.belief.relinearised import RelinearisedBelief
from estimator.belief.revision import RevisedModel, model_of, revision_id
from estimator.belief.tyre_belief import BeliefSettings, Sample
from estimator.drive_log.derived import brake_share
from estimator.model.effects import catalogue
from estimator.model.memory import delayed
from estimator.model.single_track import AUXILIARY, BEFORE_STEP_S, DRIVE_BEFORE, SIGNALS
from estimator.node import HALF_WINDOW, LATE_STEER, acting_variances, in_kind, late_drive
from hil_gateway.bus.messages import ActiveEffect, ModelRevision
from hil_gateway.config import Config
from hil_gateway.process.arrays import Array
from hil_gateway.track.track import Track

SPREAD = ("std_vx", "std_vy", "std_yaw_rate")
"""columns with the standard deviations of the estimated motion"""
EVEN = 1.5
"""longest step inside a window of samples, over the usual one: as the estimator has it"""


@dataclass(frozen=True)
class LapColumns:
    """What is learnt from: name -> (n,) columns as of `Collector`, and (n,) arc length of the map, m."""

    columns: Mapping[str, Array]
    position: Array


def learnt_model(
    declared: ModelRevision, further: Sequence[ActiveEffect], laps: LapColumns, config: Config, track: Track
) -> ModelRevision:
    """The declared model with `further` effects, learnt from `laps`; learning begins at the values these have."""
    effects = (*declared.effects, *further)
    start = declared.model_copy(update={"effects": effects})
    revised = model_of(start, config.vehicle, track.length)
    constants = None if revised.profiles else revised.constants
    belief = RelinearisedBelief(revised.model, BeliefSettings(kind=config.estimator.measurement), constants)
    belief.set_covariance(_known_before(declared, belief.scale))
    for sample in samples(laps, revised):
        belief.update(in_kind(sample, belief.settings.kind, config.vehicle))
    values = iter(belief.mean.tolist())
    tyre = {name: next(values) for name in declared.tyre}
    if constants is not None:
        effects = tuple(e.model_copy(update={"parameters": {n: next(values) for n in e.parameters}}) for e in effects)
    return start.model_copy(update={
        "tyre": tyre, "effects": effects, "covariance": tuple(map(tuple, belief.covariance.tolist())),
        "revision": revision_id(declared.layout, tyre, effects),
    })  # fmt: skip


def _known_before(declared: ModelRevision, scale: Array) -> Array:
    """Covariance (n, n) before the laps: the declared one, and for the rest of `scale` (n,) that of the catalogue."""
    covariance = np.diag(scale**2)
    known = min(len(declared.covariance), len(scale))
    if known:
        covariance[:known, :known] = np.array(declared.covariance)[:known, :known]
    return covariance


def samples(laps: LapColumns, revised: RevisedModel) -> Iterator[Sample]:
    """`imu_yaw` samples as `SampleWindow` makes them of the running estimates, but where a row is missing."""
    columns = laps.columns
    signals = np.stack([columns[name] for name in SIGNALS])
    spread = np.stack([columns[name] for name in SPREAD]) ** 2
    aux, phi = _auxiliary(laps), revised.phi_at(laps.position)
    t, half = columns["t"], HALF_WINDOW
    step = float(np.median(np.diff(t)))
    weights = np.arange(half, -half - 1, -1) / (step * sum(k * k for k in range(-half, half + 1)))
    yaw_acc = np.convolve(columns["yaw_rate"], weights, "same")
    z = np.stack([columns["ax"], columns["ay"], yaw_acc])
    gap = np.concatenate([np.diff(t) > EVEN * step, [True]])
    broken = np.convolve(gap.astype(float), np.ones(2 * half + 1), "same") > 0.5
    late = {"steer": LATE_STEER, "drive": late_drive(revised.model)}
    steer, drive = (acting_variances(columns[name], samples) for name, samples in late.items())
    for i in np.flatnonzero(~broken[half:-half]) + half:
        acting = float(steer[i]), float(drive[i])
        yield Sample(signals[:, i], np.diag(spread[:, i]), z[:, i], aux[:, i], phi[:, i], acting)


FROM_LAPS = ("t", "yaw", "throttle", "brake_balance", "gear", "engine_speed", "ax", "extra_load")
"""auxiliaries that the laps have as columns"""


def _auxiliary(laps: LapColumns) -> Array:
    """(auxiliaries, n) in the order of `AUXILIARY`."""
    columns = laps.columns
    t, drive = columns["t"], columns["drive"]
    known = {
        **{name: delayed(t, drive, k * BEFORE_STEP_S) - drive for k, name in enumerate(DRIVE_BEFORE, 1)},
        **{name: columns[name] for name in FROM_LAPS},
        "track_position": laps.position, "brake": brake_share(columns["brake"]),
        "steer_rate": np.gradient(columns["steer"], t),
    }  # fmt: skip
    neutral = np.zeros_like(laps.position)
    return np.stack([known.get(name, neutral) for name in AUXILIARY])


def parameters_of(name: str, values: Array) -> ActiveEffect:
    """An effect with the parameters found: named values, or the coefficients of its profile."""
    effect, numbers = catalogue()[name], values.tolist()
    if effect.profile:
        return ActiveEffect(name=name, parameters={}, profile=tuple(numbers))
    named = {p.name: value for p, value in zip(effect.parameters, numbers, strict=True)}
    return ActiveEffect(name=name, parameters=named)
