"""Effects outside the catalogue, each in one line of physics: what a diagnosis must call unexplained.

Every function takes the sizes `s` (name -> one entry a car), the motion `at` of the cars, and where and when local and
sudden things happen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hil_gateway.process.arrays import Array

Sizes = Mapping[str, Array]

LATERAL = {"ay", "yaw_acc", "vy_dot"}
FORWARD = {"ax", "vx_dot"}

# id -> a typical range of sizes and whether it is drawn with either sign, channels, signals; any of these is right
EFFECTS: dict[str, tuple[tuple[float, float, bool], set[str], set[str]]] = {
    "steer_compliance": ((0.08, 0.2, False), LATERAL, {"vx", "steer"}),
    "load_compliance": ((2e-4, 6e-4, False), LATERAL, {"ay", "steer", "yaw_rate", "turn_direction"}),
    "grip_patch": ((0.15, 0.4, False), LATERAL, {"track_position"}),
    "grip_step": ((0.08, 0.2, False), LATERAL, {"t"}),
    "puncture": ((0.08, 0.2, False), LATERAL, {"t"}),
    "brake_oversteer": ((0.15, 0.35, False), LATERAL, {"drive"}),
    "speed_stall": ((0.1, 0.25, False), LATERAL, {"vx"}),
    "temperature_grip": ((0.06, 0.15, False), LATERAL, {"tyre_temperature"}),
    "gust": ((500.0, 1500.0, True), LATERAL, {"track_position"}),
    "kerb": ((1500.0, 4000.0, True), LATERAL, {"track_position"}),
    "right_push": ((400.0, 1200.0, True), LATERAL, {"turn_direction"}),
    "throttle_yaw": ((300.0, 900.0, True), {"yaw_acc"}, {"drive", "throttle"}),
    "diff_lock": ((600.0, 1800.0, False), {"yaw_acc"}, {"vx", "yaw_rate", "turn_direction", "ay", "steer"}),
    "channel_force": ((300.0, 800.0, True), FORWARD, {"flap"}),
    "turn_drag": ((300.0, 800.0, True), FORWARD, {"turn_direction"}),
    "mud": ((500.0, 1500.0, False), FORWARD, {"track_position"}),
    "pulses": ((400.0, 900.0, True), FORWARD, {"t"}),
    "gusts": ((800.0, 1500.0, True), LATERAL, {"t"}),
    "damage_drag": ((0.3, 0.8, False), FORWARD, {"t"}),
    "drag_stall": ((0.2, 0.5, False), FORWARD, {"vx"}),
    "brake_fade": ((0.15, 0.3, False), FORWARD, {"t", "drive"}),
    "fade_heat": ((0.15, 0.35, False), FORWARD, {"t", "drive"}),
    "power_limit": ((0.15, 0.4, False), FORWARD, {"vx"}),
    "sensor_step": ((0.15, 0.4, True), {"ay"}, {"t"}),
    "sensor_gain": ((0.04, 0.1, True), {"ay"}, {"vx"}),
    "short_gusts": ((1500.0, 3000.0, True), LATERAL, {"t"}),
    "tyre_heat": ((0.1, 0.25, False), LATERAL, {"t", "ay", "vx", "yaw_rate"}),
    "slosh": ((80.0, 200.0, False), {"yaw_acc"}, {"ay", "yaw_rate", "steer", "turn_direction"}),
    "steer_resonance": ((0.15, 0.3, False), LATERAL, {"steer", "steer_rate"}),
    "drive_play": ((0.004, 0.01, False), FORWARD, {"drive", "drive_rate"}),
    "accelerometer_drift": ((0.25, 0.5, False), {"ax", "ay"}, {"t"}),
    "gyro_gain": ((0.02, 0.05, True), LATERAL, {"yaw_rate", "ay", "steer", "vx", "turn_direction"}),
    "ay_gain": ((0.03, 0.08, True), {"ay"}, {"ay", "yaw_rate", "steer", "turn_direction"}),
    "sticky_brake": ((300.0, 800.0, False), FORWARD, {"t", "drive", "vx", "track_position"}),
    "fuel_burn": ((0.05, 0.09, False), FORWARD, {"t", "drive"}),
    "torque_curve": ((0.15, 0.4, False), FORWARD, {"drive", "throttle"}),
    "front_stall": ((0.1, 0.25, False), LATERAL, {"vx"}),
    "traction_cut": ((0.15, 0.4, False), FORWARD, {"ay", "yaw_rate", "steer", "drive", "turn_direction"}),
    "vectoring": ((400.0, 1200.0, True), {"yaw_acc"}, {"drive", "steer", "turn_direction", "yaw_rate", "ay"}),
    "stiffness_rise": ((0.12, 0.3, True), LATERAL, {"t"}),
    "misfire": ((0.3, 0.8, False), FORWARD, {"t", "drive"}),
    "slipstream": ((0.2, 0.45, False), FORWARD, {"t"}),
    "slow_puncture": ((0.12, 0.25, False), LATERAL, {"t"}),
    "brake_pull": ((300.0, 900.0, True), {"yaw_acc"}, {"drive", "brake", "drive_rate"}),
    "torque_steer": ((0.002, 0.005, True), LATERAL, {"drive", "throttle"}),
    "slip_drag": ((300.0, 900.0, False), FORWARD, {"vy", "ay", "yaw_rate", "steer", "turn_direction"}),
    "ax_gain": ((0.05, 0.12, True), {"ax"}, {"ax", "drive", "throttle", "brake", "vx"}),
    "hot_brakes": ((0.25, 0.5, False), FORWARD, {"drive", "brake", "t", "track_position"}),
    "pressure_peak": ((0.08, 0.2, False), LATERAL, {"t"}),
    "camber_thrust": ((400.0, 1000.0, True), LATERAL, {"vx"}),
    "throttle_dead_zone": ((0.003, 0.008, False), FORWARD, {"drive", "throttle"}),
    "damaged_floor": ((0.1, 0.25, False), LATERAL, {"t"}),
    "kerb_yaw": ((1000.0, 2500.0, True), {"yaw_acc"}, {"track_position"}),
    "wall_gap": ((15.0, 40.0, True), LATERAL, {"track_position"}),
    "gyro_drift": ((0.006, 0.015, True), LATERAL, {"t"}),
    "wheel_speed": ((0.02, 0.05, False), FORWARD, {"drive", "drive_rate", "throttle", "brake"}),
    "wet_spells": ((0.08, 0.2, False), LATERAL, {"t"}),
    "rear_patch": ((0.08, 0.18, False), LATERAL, {"track_position"}),
    "rear_steer": ((4e-4, 1e-3, True), LATERAL, {"ay", "steer", "yaw_rate", "turn_direction"}),
    "brake_steer": ((0.002, 0.006, True), LATERAL, {"drive", "brake"}),
    "progressive_rack": ((0.1, 0.25, True), LATERAL, {"steer", "yaw_rate", "ay", "vx"}),
    "coast_lock": ((400.0, 1200.0, False), {"yaw_acc"}, {"drive", "yaw_rate", "turn_direction", "ay", "steer", "vx"}),
    "hot_engine": ((0.15, 0.35, False), FORWARD, {"t", "drive", "throttle"}),
    "engine_surge": ((300.0, 800.0, False), FORWARD, {"t", "drive"}),
    "standing_water": ((15.0, 40.0, False), FORWARD, {"track_position", "t"}),
    "headwind_gusts": ((8.0, 20.0, True), FORWARD, {"t"}),
    "ax_drift": ((0.3, 0.8, True), {"ax"}, {"t"}),
    # nothing that a car does
    "held_positions": ((0.1, 0.2, False), set(), set()),
    "vibration": ((1.0, 2.5, False), set(), set()),
    "spikes": ((3.0, 9.0, True), set(), set()),
    "position_lag": ((0.1, 0.3, False), set(), set()),
    "speed_lag": ((0.05, 0.15, False), set(), set()),
    "clock_jump": ((0.3, 1.5, False), set(), set()),
}
SLOSH_S, HEAT_S, DRIFT_S, RELEASE_S, RESONANCE = 0.6, 60.0, 0.5, 4.0, 2 * 3.141592653589793 * 4.0
"""s: lag of what moves in the car, of the heat of the tyres, correlation of an accelerometer's noise, release of a
brake that sticks; rad/s of the wheels about their steering axis"""
SURGE = 2 * 3.141592653589793 * 1.3
"""rad/s of an engine that surges"""
SPRINGS_S = 0.3
"""s: lag of the axle loads behind ax on soft springs"""
BRAKE_HEAT_S = 40.0
"""s: time constant by which brakes cool"""
COLUMNS, CAUSED_BY_COLUMN = ("flap", "tyre_temperature"), {"channel_force", "temperature_grip"}
"""extra columns, and the effects whose logs have them: one of the columns is the cause, the other is not"""


@dataclass(frozen=True)
class Local:
    """Where on the lap (its first share) and when (s) local and sudden things happen, per car."""

    stretch: Array
    moment: Array

    def inside(self, share: Array, width: float) -> Array:
        """Whether the car is in the stretch."""
        return np.asarray(((share - self.stretch) % 1.0) < width)

    def recurring(self, t: float, share: float, times: float) -> Array:
        """Whether what comes back so many times before `moment`, each time for a `share` of that, is there."""
        return np.asarray((t * times / self.moment) % 1.0 < share)


@dataclass(frozen=True)
class Motion:
    """Where and how every car moves at one instant."""

    t: float
    share: Array
    yaw: Array
    vx: Array
    vy: Array
    rate: Array
    steer: Array
    drive: Array
    ax_before: Array
    flap: Array
    temperature: Array
    slosh: Array
    """ay as it was shortly before, m/s2"""
    heat: Array
    """of the tyres, by the square of ay over 100 m2/s4 in the last minute"""
    stuck: Array
    """share of the largest braking that a brake which sticks still remembers"""
    brake_heat: Array
    """of the brakes, by their power over a tenth of that of braking at 40 m/s"""
    ax_slow: Array
    """ax as springs follow it, m/s2"""


def above(value: Array, threshold: float, width: float) -> Array:
    """0 below the threshold, 1 above it."""
    return np.asarray(0.5 + 0.5 * np.tanh((value - threshold) / (2 * width)))


def grip(s: Sizes, at: Motion, local: Local) -> tuple[Array, Array]:
    """Factor on D of the front and the rear axle."""
    both = 1 - s["grip_patch"] * local.inside(at.share, 0.07) - s["grip_step"] * (at.t > local.moment)
    both = both - s["speed_stall"] * above(at.vx, 40.0, 1.5) - s["temperature_grip"] * (at.temperature - 80.0) / 20.0
    both = both * (1 - s["tyre_heat"] * np.minimum(at.heat, 1.0))
    both = both * (1 - s["pressure_peak"] * min((at.t - 250.0) / 300.0, 1.2) ** 2)
    both = both * (1 - s["damaged_floor"] * (at.vx / 40.0) ** 2 * (at.t > local.moment))
    both = both * (1 - s["wet_spells"] * local.recurring(at.t, 0.4, 2.5))
    braking = np.clip(-at.drive / 0.05, 0.0, 1.0)
    flat = s["puncture"] * (at.t > local.moment) + s["slow_puncture"] * np.clip((at.t - local.moment) / 100.0, 0, 1)
    front = both * (1 - s["front_stall"] * above(at.vx, 38.0, 1.0))
    rear = both * (1 - s["rear_patch"] * local.inside(at.share, 0.06))
    return front, rear * (1 - flat) * (1 - s["brake_oversteer"] * braking)


def stiffness(s: Sizes, at: Motion) -> Array:
    """Factor on B of both axles: tyres whose pressure rises."""
    return np.asarray(1 + s["stiffness_rise"] * (1 - np.exp(-at.t / 200.0)))


def mass(s: Sizes, at: Motion) -> Array:
    """Factor on the mass: fuel that burns."""
    return np.asarray(1 - s["fuel_burn"] * min(at.t / 600.0, 1.0))


def forward_force(s: Sizes, at: Motion, local: Local) -> Array:
    """Force along the car, N."""
    air = s["drag_stall"] * above(at.vx, 38.0, 1.0) - s["damage_drag"] * (at.t > local.moment)
    against = s["mud"] * local.inside(at.share, 0.04) + s["turn_drag"] * (at.rate * at.vx > 1.0)
    pulse = s["pulses"] * local.recurring(at.t, 0.4, 10.0)
    air = air + s["slipstream"] * local.recurring(at.t, 0.45, 7.0)
    against = against + s["sticky_brake"] * at.stuck
    against = against + s["slip_drag"] * at.vy**2
    against = against + s["standing_water"] * at.vx * local.inside(at.share, 0.05) * (at.t > local.moment)
    against = against + s["headwind_gusts"] * at.vx * local.recurring(at.t, 0.3, 9.0)
    pulse = pulse + s["engine_surge"] * np.sin(SURGE * at.t) * (at.drive > 0.002)
    return np.asarray(s["channel_force"] * at.flap + pulse - against + air * at.vx**2)


def side_force(s: Sizes, at: Motion, local: Local) -> Array:
    """Force across the car, N."""
    stretch = s["gust"] * local.inside(at.share, 0.07) + s["kerb"] * local.inside(at.share, 0.025)
    stretch = stretch + s["gusts"] * local.recurring(at.t, 0.04, 8.0)
    stretch = stretch + s["short_gusts"] * local.recurring(at.t, 0.03, 20.0)
    stretch = stretch + s["wall_gap"] * at.vx * local.inside(at.share, 0.15)
    stretch = stretch + s["camber_thrust"] * (at.vx / 40.0) ** 2
    return np.asarray(stretch + s["right_push"] * (at.rate < -0.02))


def moment(s: Sizes, at: Motion, local: Local) -> Array:
    """Yaw moment, N m."""
    locked = s["diff_lock"] * np.tanh(at.rate / 0.1) * (1 - above(at.vx, 22.0, 1.5))
    push = np.maximum(at.drive, 0) / 0.05
    vectored = s["vectoring"] * push * np.tanh(at.steer / 0.02)
    pulled = s["brake_pull"] * np.clip(-at.drive / 0.05, 0.0, 1.5)
    pulled = pulled + s["kerb_yaw"] * local.inside(at.share, 0.02)
    locked = locked + s["coast_lock"] * np.tanh(at.rate / 0.1) * (at.drive < 0)
    return np.asarray(s["throttle_yaw"] * push + vectored + pulled - locked - s["slosh"] * at.slosh)


def steered(s: Sizes, at_wheel: Array, vx: Array, rate: Array, drive: Array) -> Array:
    """Road-wheel angle that is left of the one applied, and what the drive adds to it."""
    left = at_wheel * (1 - s["steer_compliance"] * (vx / 40.0) ** 2) - s["load_compliance"] * vx * rate
    left = left + s["progressive_rack"] * at_wheel * np.minimum(np.abs(at_wheel) / 0.1, 1.5)
    left = left + s["brake_steer"] * np.clip(-drive / 0.05, 0.0, 1.5)
    return np.asarray(left + s["torque_steer"] * np.maximum(drive, 0.0) / 0.05)


def steered_behind(s: Sizes, vx: Array, rate: Array) -> Array:
    """Angle, rad, of a rear axle that turns as the body rolls."""
    return np.asarray(s["rear_steer"] * vx * rate)


def driven(s: Sizes, at: Motion, local: Local) -> Array:
    """Drive command that reaches the wheels."""
    left = 1 - s["brake_fade"] * np.clip((at.t - 250.0) / 300.0, 0, 1) - s["fade_heat"] * (1 - np.exp(-at.t / 250.0))
    tired = s["hot_engine"] * np.clip((at.t - 150.0) / 250.0, 0, 1)
    left = left - s["hot_brakes"] * np.minimum(at.brake_heat, 1.5)
    pushed = 1 - s["power_limit"] * above(at.vx, 32.0, 2.0) - s["misfire"] * local.recurring(at.t, 0.03, 60.0)
    pushed = pushed - tired - s["traction_cut"] * np.clip(np.abs(at.vx * at.rate) / 12.0, 0, 1)
    pushed = pushed * np.clip(at.drive / 0.03, 1e-3, 2.0) ** s["torque_curve"]
    pushed = pushed * np.clip(1 - s["throttle_dead_zone"] / np.maximum(at.drive, 1e-9), 0, 1)
    return np.asarray(at.drive * np.where(at.drive < 0, left, pushed))


def sensed(s: Sizes, ay: Array, vx: Array, t: Array, moment_s: Array) -> Array:
    """What the lateral accelerometer reports of `ay`."""
    gain = 1 + s["sensor_gain"] * above(vx, 33.0, 0.5) + s["ay_gain"]
    return np.asarray(ay * gain + s["sensor_step"] * (t > moment_s))


def disturbed(s: Mapping[str, float], name: str, vx: Array, seed: int) -> tuple[Array, Array]:
    """Factor on the noise of channel `name`, which grows with speed, and what spikes add to it, (n,) each."""
    shaken = name in {"ax", "ay", "yaw_rate"}
    hit = np.random.default_rng([seed, 79]).random(len(vx)) < 5e-4 if name == "ay" else np.zeros(len(vx), dtype=bool)
    return 1 + shaken * s.get("vibration", 0.0) * (vx / 40.0) ** 2, np.asarray(s.get("spikes", 0.0) * hit)
