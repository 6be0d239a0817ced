"""The vehicle model at one stage of the horizon: what cost, limits and information are all functions of."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from estimator.model.single_track import SingleTrack, Terms
from hil_gateway.process.arrays import Expr
from planner.problem.motion import DRIVE, STEER, VX, Dynamics, auxiliary, split
from planner.problem.settings import Settings


class StageModel:
    """One model (list of active effects) with the settings of the plan; `dynamics` moves it over one interval."""

    def __init__(self, model: SingleTrack, settings: Settings) -> None:
        self.model, self.settings = model, settings
        self.dynamics = Dynamics(model, settings.dt, settings.brakes)

    def evaluate(self, z: Expr, theta: Expr, p: Mapping[str, Expr]) -> Terms:
        """Forces, loads and accelerations at state z (NZ,) for tyre parameters theta; SI, body frame."""
        parts = ca.vertsplit(z)
        aux = auxiliary(self.model, self.settings.brakes, parts, p)
        signals = (z[VX], z[4], z[5], z[STEER], z[DRIVE])
        return self.model.evaluate(Terms(self.model.vehicle, *signals, aux=aux), split(theta), split(p["phi"]))
