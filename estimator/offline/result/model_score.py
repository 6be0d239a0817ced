"""How well a vehicle model predicts a session: open-loop prediction over one second on a part it has not learnt from.

The score of a model is the RMS error after `HORIZON_S` of simulation from the estimated state, driven by the
steering and drive the car reported. Two model revisions are scored on the same windows: the one the session
began with, and the one learnt by two thirds of it, both on the last third.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from estimator.belief.revision import RevisedModel, model_of
from estimator.belief.tyre_belief import BeliefSettings
from estimator.model.extra_load import extra_loads
from estimator.model.single_track import AUXILIARY, SIGNALS, Terms
from estimator.offline.record.map_road import projected
from estimator.offline.result.diagnosis_score import HORIZON_S
from hil_gateway.bus.messages import ModelRevision
from hil_gateway.bus.topics import MODEL_REVISION
from hil_gateway.config import Config
from hil_gateway.process.arrays import Array
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError
from hil_gateway.session.drive_table import read_drive_table
from hil_gateway.session.files.reader import SessionReader
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track

SPACING_S = 0.25
LONGEST_STEP_S = 0.06
"""a longer one is a gap, over which no window reaches"""
LEARNT_SHARE = 2.0 / 3.0
"""part of the session a revision may have learnt from; the rest is held out"""
MIN_WINDOWS = 10
STATES = ("vx", "vy", "yaw_rate", "yaw", "x", "y")


@dataclass(frozen=True)
class HeldOutWindows:
    """Stretches of equal length: `signals` name -> (steps + 1, windows); `steps` (steps, windows), s."""

    signals: Mapping[str, Array]
    steps: Array

    @cached_property
    def count(self) -> int:
        """Number of windows."""
        return int(self.signals["vx"].shape[1])


def score_session(path: Path, config: Config) -> dict[str, Any]:
    """Prediction error of the first and of the learnt revision of a session on its last third.

    Returns:
        horizon_s, windows, revisions, and `before`, `after`: RMS error of vx, vy (m/s), yaw_rate (rad/s) and
        position (m) at the horizon.

    Raises:
        InputError: too short a session, or one without model revisions.
    """
    table = read_drive_table(path)
    split_s = _split(table.columns)
    first, learnt = _revisions(path, table.start_ns + int(split_s * NS_PER_S))
    return score_revisions(table.columns, first, learnt, config, split_s)


def score_revisions(
    columns: Mapping[str, Array], first: ModelRevision, learnt: ModelRevision, config: Config, from_s: float = 0.0
) -> dict[str, Any]:
    """As `score_session`, for two revisions on the columns of a drive log from `from_s` on."""
    track = load_track(config.track)
    windows = held_out_windows(columns, from_s, track)
    before, after = (prediction_error(model_of(r, config.vehicle, track.length), windows) for r in (first, learnt))
    return {
        "horizon_s": HORIZON_S,
        "windows": windows.count,
        "revisions": {"before": first.revision, "after": learnt.revision},
        "before": before,
        "after": after,
    }


def _split(columns: Mapping[str, Array]) -> float:
    """Time before which `LEARNT_SHARE` of the driving lies, s."""
    driving = columns["t"][columns["vx"] > BeliefSettings.min_speed]
    return float(driving[int(LEARNT_SHARE * len(driving))]) if len(driving) else 0.0


def _revisions(path: Path, until_ns: int) -> tuple[ModelRevision, ModelRevision]:
    """The revision a session began with, and the newest one at `until_ns`."""
    items = SessionReader(path, frozenset({MODEL_REVISION.key})).items()
    known = [ModelRevision.model_validate_json(item.data) for item in items]
    known = [revision for revision in known if revision.stamp_ns <= until_ns]
    if not known:
        raise InputError(f"{path}: holds no model revision from its first two thirds: nothing to score")
    return known[0], known[-1]


def held_out_windows(columns: Mapping[str, Array], split_s: float, track: Track) -> HeldOutWindows:
    """Windows of the drive after `split_s`, without gaps and fast enough.

    Raises:
        InputError: fewer than `MIN_WINDOWS` of them.
    """
    t = columns["t"]
    step = float(np.median(np.diff(t)))
    length, spacing = round(HORIZON_S / step), max(round(SPACING_S / step), 1)
    signals = dict(columns)
    signals["track_position"] = projected(columns, track)[0]
    if "az" in columns:
        signals["extra_load"] = extra_loads(columns["az"])
    signals["steer_rate"], signals["drive_rate"] = (np.gradient(columns[n], t) for n in ("steer", "drive"))
    starts = np.arange(int(np.searchsorted(t, split_s)), len(t) - length, spacing)
    rows = starts + np.arange(length + 1)[:, None]
    whole = np.diff(t[rows], axis=0).max(axis=0, initial=0.0) < LONGEST_STEP_S
    rows = rows[:, whole & (columns["vx"][rows].min(axis=0, initial=np.inf) > BeliefSettings.min_speed)]
    if rows.shape[1] < MIN_WINDOWS:
        raise InputError(
            f"only {rows.shape[1]} windows of {HORIZON_S:g} s above {BeliefSettings.min_speed:g} m/s in the part that"
            f" is held out: at least {MIN_WINDOWS} are needed for a score; drive longer"
        )
    return HeldOutWindows({name: column[rows] for name, column in signals.items()}, np.diff(t[rows], axis=0))


def prediction_error(revised: RevisedModel, windows: HeldOutWindows) -> dict[str, float]:
    """RMS error at the horizon, one figure per channel."""
    end = simulate(revised, windows)
    error = {name: end[i] - windows.signals[name][-1] for i, name in enumerate(STATES)}
    rms = {name: float(np.sqrt(np.mean(error[name] ** 2))) for name in ("vx", "vy", "yaw_rate")}
    return {**rms, "position": float(np.sqrt(np.mean(error["x"] ** 2 + error["y"] ** 2)))}


def simulate(revised: RevisedModel, windows: HeldOutWindows) -> Array:
    """States (6, windows) at the end of every window, integrated by RK4 from its first sample.

    Effects with memory act in their first-order form, as they do in the planner.
    """
    signals, rates = windows.signals, _rates(revised, windows.count)
    phi = [revised.phi_at(position) for position in signals["track_position"]]
    zero = np.zeros_like(signals["vx"])
    inputs = np.stack([signals.get(name, zero) for name in (*SIGNALS[3:], *AUXILIARY)])
    x = np.stack([signals[name][0] for name in STATES])
    for k, h in enumerate(windows.steps):
        here, there = inputs[:, k], inputs[:, k + 1]
        middle = (here + there) / 2
        k1 = rates(x, here, phi[k])
        k2 = rates(x + h / 2 * k1, middle, phi[k])
        k3 = rates(x + h / 2 * k2, middle, phi[k])
        k4 = rates(x + h * k3, there, phi[k + 1])
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return np.asarray(x)


def _rates(revised: RevisedModel, count: int) -> Callable[[Array, Array, Array], Array]:
    """d/dt of the states (6, count) for inputs (2 + auxiliaries, count) and effect parameters (n_phi, count)."""
    state, inputs = ca.SX.sym("state", len(STATES)), ca.SX.sym("inputs", 2 + len(AUXILIARY))
    phi = ca.SX.sym("phi", len(revised.constants))
    vx, vy, yaw_rate, yaw, _, _ = ca.vertsplit(state)
    steer, drive, *auxiliary = ca.vertsplit(inputs)
    terms = Terms(
        revised.model.vehicle, vx, vy, yaw_rate, steer, drive, aux=dict(zip(AUXILIARY, auxiliary, strict=True))
    )
    revised.model.evaluate(terms, revised.theta.tolist(), ca.vertsplit(phi) if phi.numel() else [])
    cos, sin = ca.cos(yaw), ca.sin(yaw)
    pose = (yaw_rate, vx * cos - vy * sin, vx * sin + vy * cos)
    rate = ca.Function("rate", [state, inputs, phi], [ca.vertcat(terms.vx_dot, terms.vy_dot, terms.yaw_acc, *pose)])
    mapped = rate.map(count)

    def rates(x: Array, u: Array, p: Array) -> Array:
        return np.asarray(mapped(x, u, p))

    return rates
