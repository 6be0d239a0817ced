"""The lateral motion of a log none of whose lateral sensors can be compared at the measured states.

Where the yaw rate was late and vy is displaced, a prediction at the measured states is off by what the sensors are off
by. `hil identify` simulates vy and yaw rate from steer and vx instead and estimates those errors along with the tyres:
a diagnosis takes its tyres and its errors from there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from estimator.drive_log.table import DriveLog
from estimator.model.parameters import Layout
from estimator.offline.health.acceleration import rederived
from estimator.offline.identification import Identification, Options, Progress, identify
from estimator.offline.predict.nuisance import KNOWN_BANK
from estimator.offline.record.record import LATERAL_ROWS, Record
from estimator.offline.tyre_export import exported
from hil_gateway.car.vehicle import Vehicle

NOTE = (
    "ay, yaw_acc and vy_dot, and vy and yaw_rate after the horizon, are simulated over windows of {:g} s from steer and"
    " vx on blocks held out, as by `hil identify`: no lateral sensor of this log can be compared at the measured states"
)


def identified_laterally(  # noqa: PLR0917 - as `identify`
    log: DriveLog,
    record: Record,
    vehicle: Vehicle,
    prior: Mapping[str, float],
    layout: Layout,
    progress: Progress = lambda what, share: None,
) -> Identification | None:
    """The identification of a `log` whose `record` has no lateral sensor that can be used; None where it has one."""
    if record.used[LATERAL_ROWS].any():
        return None
    return identify(log, vehicle, prior, Options(layout=layout), progress)


def repaired_log(result: Identification) -> DriveLog:
    """The log as the identification repaired it, without the bank that it took for known.

    A vy that is displaced, times the yaw rate, is an acceleration along the car that comes back in every bend, as a
    grade does.
    """
    log = replace(result.log, columns={n: c for n, c in result.log.columns.items() if n != KNOWN_BANK})
    return rederived(log, ("ay",), "ay derived from the motion as `hil identify` repaired it")


def lateral_prior(result: Identification, prior: Mapping[str, float]) -> dict[str, float]:
    """The tyre `prior` with the lateral parameters that the log determines."""
    return {**prior, **{name: value for name, value in exported(result).items() if name != "cx"}}


def with_simulated_lateral(summary: Mapping[str, Any], result: Identification) -> dict[str, Any]:
    """A diagnosis as JSON with the lateral errors of `result`, and without what rests on others."""
    channels, ahead = dict(summary["channels"]), dict(summary["rollout"])
    for name, simulated in (("ay", "ay"), ("yaw_acc", "yaw_acc"), ("vy_dot", "ay")):
        channels[name] = {**_errors(result, simulated), "noise_floor": summary["channels"][name]["noise_floor"]}
    for name in ("vy", "yaw_rate"):
        ahead[name] = _errors(result, name)
    note = NOTE.format(result.options.window_s)
    far_ahead = {name: row for name, row in summary["long_rollout"].items() if name not in {"vy", "yaw_rate"}}
    return {
        **summary, "channels": channels, "rollout": ahead, "long_rollout": far_ahead, "lap_time_s": {}, "lateral": note,
    }  # fmt: skip


def _errors(result: Identification, channel: str) -> dict[str, float]:
    """Before and after under the keys of a diagnosis: its effects do not act across the car here."""
    before, after = result.rmse[channel]
    return {"declared": before, "refit": after, "catalogue": after, "with_effects": after}
