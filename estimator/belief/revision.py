"""Model revisions: the vehicle model as a message, and when the estimator sends a new one.

A revision moves only after enough samples, by more than a hysteresis, by at most one step at a time, and never
outside bounds around where it started: an early wild belief cannot reach the planner. It keeps up with the belief
within two or three seconds: a car whose rear axle is weaker than the model in force says is lost in its first bend.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from estimator.belief.tyre_belief import TyreBelief
from estimator.model.declared_car import declared_covariance, declared_effects
from estimator.model.effects import catalogue
from estimator.model.parameters import LAYOUTS, Layout, Quantity, layout_of, tyre_prior
from estimator.model.profile import profile_basis
from estimator.model.single_track import SingleTrack
from hil_gateway.bus.messages import ActiveEffect, ModelRevision
from hil_gateway.bus.revision_file import read_revision
from hil_gateway.car.car import Car
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.config import Config, EstimatorConfig
from hil_gateway.process.arrays import Array
from hil_gateway.process.errors import InputError

SESSION_SPREAD = 0.05
"""relative, one standard deviation, of every parameter from one session to the next: another set of tyres, another
temperature of track and tyres, fuel; twice of it is the tenth by which grip differs between a cold and a warm track. Of
one that may have either sign or is none it is relative to its usual size: a rack whose zero is known is taken apart"""


def revision_id(layout: str, tyre: Mapping[str, float], effects: Sequence[ActiveEffect] = ()) -> str:
    """Content hash of a model: equal models have equal ids on every computer."""
    content = {"layout": layout, "tyre": dict(sorted(tyre.items())), "effects": [e.model_dump() for e in effects]}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]


def declared_revision(tyre: Mapping[str, float]) -> ModelRevision:
    """The declared model, Eq. (1)-(3), with no effects."""
    layout = layout_of(tyre)
    return ModelRevision(stamp_ns=0, seq=0, revision=revision_id(layout, tyre), layout=layout, tyre=dict(tyre))


def race_car_revision(car: Car, layout: Layout) -> ModelRevision:
    """The declared race car: Eq. (1)-(3) with its declared effects, and how well all of it is known."""
    tyre, declared = tyre_prior(car, layout), declared_effects(car)
    effects = tuple(
        ActiveEffect(name=name, parameters={key: p.value for key, p in parameters.items()})
        for name, parameters in declared.items()
    )
    covariance = tuple(map(tuple, declared_covariance(car, layout).tolist()))
    return ModelRevision(
        stamp_ns=0, seq=0, revision=revision_id(layout, tyre, effects), layout=layout, tyre=tyre, effects=effects,
        covariance=covariance,
    )  # fmt: skip


def starting_revision(config: Config, model: str) -> ModelRevision:
    """The model a process starts with: that of the file `model` as far as it still holds, or else the declared one.

    Raises:
        InputError: see `load_revision`.
    """
    if model:
        return carried_over(load_revision(model))
    layout = config.estimator.layout
    if config.declared_model == "paper":
        return declared_revision(tyre_prior(config.declared_car, layout))
    return race_car_revision(config.declared_car, layout)


def carried_over(revision: ModelRevision) -> ModelRevision:
    """A model of an earlier session, no surer of itself than sessions differ (`SESSION_SPREAD`)."""
    if not revision.covariance:
        return revision
    named = [(e, p) for e in revision.effects for p in catalogue()[e.name].parameters if p.name in e.parameters]
    known = [(e.parameters[p.name], p) for e, p in named]
    sizes = [max(abs(value), p.prior_std if p.lower < 0.0 or value == 0.0 else 0.0) for value, p in known]
    spread = np.zeros(len(revision.covariance))
    for i, size in zip(range(len(spread)), [*revision.tyre.values(), *sizes], strict=False):
        spread[i] = SESSION_SPREAD * size
    widened = np.array(revision.covariance) + np.diag(spread**2)
    return revision.model_copy(update={"covariance": tuple(map(tuple, widened.tolist()))})


def load_revision(path: str | Path) -> ModelRevision:
    """Read a model revision (`model.json`).

    Raises:
        InputError: unreadable, not a revision, with an effect this version does not know, or with parts that do not
            fit each other: a file edited by hand.
    """
    revision = read_revision(path)
    if found := inconsistent(revision):
        raise InputError(f"{path}: {found}")
    content = revision_id(revision.layout, revision.tyre, revision.effects)
    if revision.revision != content:
        raise InputError(
            f"{path}: revision is {revision.revision}, its content has {content}: it was edited; "
            f'where that is meant, write "revision": "{content}"'
        )
    return revision


@dataclass(frozen=True)
class RevisedModel:
    """The single-track model of a revision with its numbers."""

    model: SingleTrack
    theta: Array
    """tyre parameters in the order of `model.tyre_table`, SI"""
    constants: Array
    """effect parameters in the order of `model.effect_table`; 0 where a profile over the lap takes their place"""
    profiles: Mapping[int, Array]
    """index into `constants` -> spline coefficients over track position"""
    lap_length: float

    def phi_at(self, track_position: Array) -> Array:
        """Effect parameters at track positions (K,), m: shape (n_phi, K)."""
        phi = np.repeat(self.constants[:, None], len(track_position), axis=1)
        for row, coefficients in self.profiles.items():
            phi[row] = profile_basis(track_position, self.lap_length, len(coefficients)) @ coefficients
        return phi

    def constant(self, quantity: Quantity) -> float | None:
        """A quantity that is the same all over the lap; None where no active effect has it."""
        place = self.model.place_of(quantity)
        return None if place is None else float(self.constants[place])


def model_of(revision: ModelRevision, vehicle: Vehicle, lap_length: float) -> RevisedModel:
    """The model a revision describes, on a track of `lap_length` m."""
    effects = tuple(catalogue()[e.name] for e in revision.effects)
    model = SingleTrack(vehicle, revision.tyre, effects)
    constants: list[float] = []
    profiles: dict[int, Array] = {}
    for effect, active in zip(effects, revision.effects, strict=True):
        if active.profile:
            profiles[len(constants)] = np.array(active.profile)
        constants += [active.parameters.get(p.name, 0.0) for p in effect.parameters]
    theta = np.array([revision.tyre[p.name] for p in model.tyre_table])
    return RevisedModel(model, theta, np.array(constants), profiles, lap_length)


def tyre_covariance(revision: ModelRevision) -> Array | None:
    """Covariance (n, n) of a revision's tyre parameters; None where it states none."""
    n = len(revision.tyre)
    return np.array(revision.covariance)[:n, :n] if revision.covariance else None


def unusable(revision: ModelRevision, current: ModelRevision) -> str:
    """Why learning cannot go on from a revision in the place of the `current` one; empty when it can."""
    if revision.layout != current.layout:
        return f"its tyres are not those of layout {current.layout}"
    return inconsistent(revision) or ("" if revision.covariance else "it states no covariance")


def inconsistent(revision: ModelRevision) -> str:
    """Which parts of a revision do not fit each other or the catalogue; empty when all do."""
    layout = layout_of(revision.tyre)
    if layout != revision.layout or revision.tyre.keys() != set(LAYOUTS[layout]):
        return f"its tyres are not those of layout {revision.layout}"
    if unknown := [e.name for e in revision.effects if e.name not in catalogue()]:
        return f"effect {unknown[0]} is not in the catalogue: {', '.join(catalogue())}"
    for effect in revision.effects:
        if not effect.profile and [*effect.parameters] != [p.name for p in catalogue()[effect.name].parameters]:
            return f"parameters of {effect.name} are not those of the catalogue"
    everything = len(revision.tyre) + sum(len(e.parameters) for e in revision.effects)
    if revision.covariance and len(revision.covariance) not in (len(revision.tyre), everything):
        return f"its covariance has {len(revision.covariance)} rows for {everything} parameters"
    return ""


def effect_values(revision: ModelRevision) -> dict[Quantity, tuple[int, float]]:
    """Quantities that the effects of a revision have: row of its covariance, where that is about them, and value."""
    named = [(e, p) for e in revision.effects for p in catalogue()[e.name].parameters if p.name in e.parameters]
    rows = enumerate(named, len(revision.tyre))
    return {p.quantity: (row, e.parameters[p.name]) for row, (e, p) in rows if p.quantity is not None}


def learns_effects(revision: ModelRevision) -> bool:
    """Whether the belief is about the effects of a revision too: its covariance covers them."""
    return len(revision.covariance) > len(revision.tyre)


class RevisionPolicy:
    """Decides what the planner is told; holds the revision now in force."""

    def __init__(self, config: EstimatorConfig, start: ModelRevision) -> None:
        self._config = config
        self.current = start
        self._with_effects = learns_effects(start)
        self._start = self._values(start)
        size, known = len(self._start), np.array(start.covariance)
        # a change is relative to the value, or to its spread where that is larger: offsets may start at nothing
        self._spread = np.sqrt(np.diag(known)[:size]) if len(known) >= size else np.zeros(size)

    @property
    def _bounds(self) -> tuple[Array, Array]:
        """Where values may go: by a factor from where they started, or as far to either side as that of an offset."""
        low, high = self._config.revision_bounds
        start, spread = self._start, self._spread
        offset, room = np.abs(start) < spread, np.maximum(np.abs(start), spread)
        return start - room * np.where(offset, high, 1.0 - low), start + room * np.where(offset, high, high - 1.0)

    def _values(self, revision: ModelRevision) -> Array:
        """What may move: tyre parameters, then those of the effects where they are learnt."""
        effects = revision.effects if self._with_effects else ()
        return np.array([*revision.tyre.values(), *(v for e in effects for v in e.parameters.values())])

    def message(self, belief: TyreBelief, stamp_ns: int, seq: int) -> ModelRevision:
        """The revision to publish now: the one in force, moved towards the belief where that is due."""
        tyre, effects = self._split(self._next_values(belief))
        covariance = tuple(map(tuple, belief.covariance.tolist()))
        self.current = self.current.model_copy(update={
            "stamp_ns": stamp_ns, "seq": seq, "tyre": tyre, "effects": effects, "covariance": covariance,
            "revision": revision_id(self.current.layout, tyre, effects),
        })  # fmt: skip
        return self.current

    def _next_values(self, belief: TyreBelief) -> Array:
        c, old = self._config, self._values(self.current)
        if not c.learn or belief.samples < c.revision_min_samples:
            return old
        change = np.clip(belief.mean, *self._bounds) - old
        largest = float(np.max(np.abs(change) / np.maximum(np.abs(old), self._spread)))
        if largest < c.revision_hysteresis:
            return old
        # one factor for all parameters keeps to the line between the models: combinations stay meaningful
        return np.asarray(old + change * min(1.0, c.revision_max_step / largest))

    def _split(self, values: Array) -> tuple[dict[str, float], tuple[ActiveEffect, ...]]:
        """Tyre parameters and effects of `_values`."""
        left = iter(values.tolist())
        tyre = {name: next(left) for name in self.current.tyre}
        if not self._with_effects:
            return tyre, self.current.effects
        moved = ((e, {name: next(left) for name in e.parameters}) for e in self.current.effects)
        return tyre, tuple(e.model_copy(update={"parameters": values}) for e, values in moved)
