"""Bank of the road from the roll of the body against the horizon, where a log has such a channel.

roll = bank + k ay + offset: the body leans with the road, out of the bend on its springs, and the sensor has a zero.
Source: Milliken & Milliken, Race Car Vehicle Dynamics, ch. 9 and 16.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimator.offline.record.record import Record, RoadProfile
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.process.arrays import Array

LARGEST_RAD = 0.8
"""A roll that exceeds this is in degrees: the steepest speedway (33 deg) and the lean on it stay below."""
STEEP = 0.1
"""rad; of the mean lean in bends against straights: no race car rolls so far on its springs, so it is the road, and the
road leans into the bend, which tells the channel's sign. Below, neither can be told."""
BENDS, STRAIGHTS = 0.8, 0.3
"""quantiles of curvature above and below which the road bends and does not"""
ROLL_PRIORS = (0.15, 0.05)
"""Prior standard deviations, as g times an angle: of the zero, m/s2 (0.9 deg), and of k (0.3 deg per m/s2)."""
ROLL_STRAIGHT = 0.1
"""rad; the straights of tri-ovals are banked by 9 deg, and an attitude's zero is known better than that"""
ROLL_STD = 0.01
"""rad; what a roll channel is off by at a place in every lap: attitude filters take long bends for level (0.5 deg)"""


def bank_by_roll(record: Record) -> tuple[Array, Array] | None:
    """(windows, blocks) of -g sin(roll), left side up positive, and of the lateral force felt, m/s2; None without."""
    name = next((n for n in record.extra if _is_roll(n)), None)
    if name is None:
        return None
    roll = record.thin(_in_rad(record.signals[name]))
    vx, _, rate = record.state_means
    curvature = rate / np.maximum(vx, 1.0)
    sharp = np.abs(curvature) > np.quantile(np.abs(curvature), BENDS)
    level = np.abs(curvature) < np.quantile(np.abs(curvature), STRAIGHTS)
    lean = float(np.mean(np.sign(curvature[sharp]) * (roll[sharp] - np.median(roll[level]))))
    if abs(lean) < STEEP:
        return None
    gravity = GRAVITY * np.sin(np.sign(lean) * roll)
    return gravity, vx * rate - gravity


def no_surer_than_roll(profile: RoadProfile) -> RoadProfile:
    """The profile with the error that such a channel has in every lap."""
    covariance = np.linalg.inv(profile.precision) + ROLL_STD**2 * np.eye(len(profile.coefficients))
    return replace(profile, precision=np.asarray(np.linalg.inv(covariance), np.float64))


def _is_roll(name: str) -> bool:
    """roll, roll_deg, roll_logged and the like, but no rate."""
    return name.split("_", maxsplit=1)[0] == "roll" and "rate" not in name


def _in_rad(roll: Array) -> Array:
    return np.radians(roll) if float(np.quantile(np.abs(roll), 0.99)) > LARGEST_RAD else roll
