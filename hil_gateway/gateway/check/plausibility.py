"""Findings about what the messages say: at standstill, and while the car is pushed. Pure.

Signs follow ISO 8855: x forward, y left, z up, so at rest an accelerometer feels +1 g along z; yaw rate and
steering are positive to the left; in a left turn the right wheels are the faster ones.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from can_dbc.quantities import WHEELS
from hil_gateway.car.car import Car
from hil_gateway.car.states import SysState, meanings
from hil_gateway.car.vehicle import GRAVITY, Vehicle
from hil_gateway.config import Config
from hil_gateway.gateway.check.finding import Finding, Verdict
from hil_gateway.gateway.check.observation import Observation
from hil_gateway.process.arrays import Array
from hil_gateway.track.geodesy import LocalMap

AREA = "plausibility"
STANDING_SPEED = 0.3
"""Faster than this is moving, m/s."""
TILT_MAX = np.radians(15.0)
"""Steepest bank or slope the car is parked on."""
GRAVITY_TOLERANCE = 0.1 * GRAVITY
RATE_BIAS_MAX = np.radians(2.0)
CENTRE_MAX = np.radians(2.0)
"""Steering off centre, at the road wheel."""
WHEEL_SPREAD = 0.25
"""Wheels of a car pushed around a bend differ by less, share of their mean."""
YAW_SEEN, ACCELERATION_SEEN = 0.05, 0.3
"""Yaw rate and acceleration below which a sign is not judged, rad/s and m/s2."""
PUSH_S = 0.5
"""People change how they push no faster: samples of less than that apart are one."""
CHANCE = 3.0
"""Standard deviations of the correlation of nothing (1 / sqrt(n)) that a sign must exceed to be told."""
JUMP, JUMP_RATE = 3.0, 1.0
"""m/s2 and rad/s from one frame to the next, 10 ms on: no car that stands or is pushed does that, swapped bytes do."""
PUSHED_M, SPEED_SPREAD = 3.0, 0.2
"""Least way by the positions on which speeds are judged, m, and by how much they may differ: a tyre that is low."""
MIN_SAMPLES = 20
NOTHING: tuple[Array, Array] = (np.zeros(0), np.zeros(0))
"""series of a quantity that the car does not report"""


def judge_signals(seen: Observation, config: Config) -> list[Finding]:
    """Everything the values themselves can tell."""
    swapped = _byte_order(seen)
    imus = [f"imu.{name}" for name in config.car.imus if not _within(seen, f"imu.{name}", swapped)]
    findings = [*swapped.values(), *_limits(seen, swapped), *_frozen(seen, imus)]
    findings += [*_states(seen), *_position(seen, config)]
    speeds = wheel_speeds(seen)
    if speeds is None:
        return findings
    time, by_wheel = speeds
    if max(float(v.max()) for v in by_wheel.values()) < STANDING_SPEED:
        remedy = "push the car forward around a left bend while the check runs: it then judges the signs"
        hint = Finding(area=AREA, name="movement", verdict=Verdict.INFO, detail="standing still", remedy=remedy)
        of_imus = [found for imu in imus for found in (*_gravity(seen, imu), *_rates_at_rest(seen, imu))]
        return [*findings, hint, *of_imus, *_steering_at_rest(seen, config.car)]
    signs = [found for imu in imus for found in _signs(seen, imu, time, by_wheel, config.vehicle)]
    return [*findings, *_wheels_agree(by_wheel), *_speed_agrees(seen, time, by_wheel, config), *signs]


def wheel_speeds(seen: Observation) -> tuple[Array, dict[str, Array]] | None:
    """(time, speed by wheel), m/s; None when there is too little."""
    time, _ = seen.series["wheel_speed_fl"]
    if time.size < MIN_SAMPLES:
        return None
    return time, {wheel: seen.series[f"wheel_speed_{wheel}"][1] for wheel in WHEELS}


def _finding(name: str, good: bool, detail: str, remedy: str = "", bad: Verdict = Verdict.FAIL) -> Finding:
    return Finding(
        area=AREA, name=name, verdict=Verdict.OK if good else bad, detail=detail, remedy="" if good else remedy
    )


def _byte_order(seen: Observation) -> dict[str, Finding]:
    """Messages of an IMU whose readings jump from frame to frame, by name: what was noise has become the high byte."""
    found = {}
    for quantity, place in seen.signals.reports.items():
        _, values = seen.series.get(quantity, NOTHING)
        if not quantity.startswith("imu.") or values.size < MIN_SAMPLES:
            continue
        jump = float(np.median(np.abs(np.diff(values))))
        if jump > (JUMP_RATE if quantity.endswith("_rate") else JUMP):
            unit, message = ("rad/s" if quantity.endswith("_rate") else "m/s2"), place.message
            detail = f"{quantity} jumps by {jump:.1f} {unit} from frame to frame"
            remedy = f"{message.id_text}: read as {message.byte_order}-endian; has its sender the other byte order?"
            found[message.name] = _finding(f"byte order, {message.name}", False, detail, remedy)
    return found


def _within(seen: Observation, imu: str, messages: Mapping[str, Finding]) -> bool:
    """Whether a reading of an IMU comes in one of these messages."""
    places = seen.signals.reports.items()
    return any(place.message.name in messages for quantity, place in places if quantity.startswith(f"{imu}."))


def _limits(seen: Observation, left_out: Mapping[str, Finding]) -> list[Finding]:
    """Every signal of the car that left what the car can do (`bus.toml`)."""
    findings = []
    for name, place in seen.signals.reports.items():
        record, limits = seen.records[place.message.name], place.signal.limits
        if not record.frames or limits is None or place.message.name in left_out:
            continue
        ends = sorted((e[name] - place.offset) / place.factor for e in (record.lowest, record.highest))
        if not limits[0] <= ends[0] <= ends[1] <= limits[1]:
            possible = f"{limits[0]:g} to {limits[1]:g}"
            detail = f"{ends[0]:g} to {ends[1]:g} {place.signal.unit}, possible are {possible}"
            remedy = f"{record.layout.id_text}: sensor, wiring, or another version of the car's DBC"
            findings.append(_finding(place.signal.name, False, detail, remedy))
    if not findings and not left_out and any(record.frames for record in seen.records.values()):
        findings.append(_finding("ranges", True, "every signal within what the car can do"))
    return findings


def _frozen(seen: Observation, imus: list[str]) -> list[Finding]:
    """Noise alone moves the last bit of a live sensor."""
    findings = []
    for name in (f"{imu}.{reading}" for imu in imus for reading in ("ax", "ay", "az", "yaw_rate")):
        _, values = seen.series[name]
        if values.size >= MIN_SAMPLES and float(np.ptp(values)) == 0.0:
            detail = f"exactly {values[0]:.4g} in all {values.size} frames"
            findings.append(
                _finding(name, False, detail, "the sensor hangs or is simulated without noise", Verdict.WARN)
            )
    return findings


def _mean(seen: Observation, signal: str) -> float | None:
    _, values = seen.series.get(signal, NOTHING)
    return float(values.mean()) if values.size >= MIN_SAMPLES else None


def _gravity(seen: Observation, imu: str) -> list[Finding]:
    """At rest the accelerometer feels 1 g upwards and nothing else."""
    means, name = [_mean(seen, f"{imu}.a{axis}") for axis in "xyz"], f"gravity, {imu}"
    if any(mean is None for mean in means):
        return []
    felt = np.array(means, dtype=np.float64)
    size = float(np.linalg.norm(felt))
    detail = f"ax {felt[0]:+.2f}, ay {felt[1]:+.2f}, az {felt[2]:+.2f} m/s2 at rest"
    if abs(size - GRAVITY) > GRAVITY_TOLERANCE:
        return [_finding(name, False, f"{detail}: {size / GRAVITY:.2f} g in all", "scale or bias of the IMU")]
    if felt[2] >= size * np.cos(TILT_MAX):
        return [_finding(name, True, detail)]
    axis = int(np.abs(felt).argmax())
    sign = "+" if felt[axis] > 0 else "-"
    return [
        _finding(
            name,
            False,
            f"{detail}: up is along {sign}{'xyz'[axis]}",
            "the IMU is mounted turned, or axes are swapped",
        )
    ]


def _rates_at_rest(seen: Observation, imu: str) -> list[Finding]:
    findings = []
    for signal in (f"{imu}.yaw_rate", f"{imu}.roll_rate"):
        mean = _mean(seen, signal)
        if mean is not None:
            detail = f"{np.degrees(mean):+.2f} deg/s at rest"
            findings.append(_finding(signal, abs(mean) <= RATE_BIAS_MAX, detail, "bias of the IMU, or the car moved"))
    return findings


def _steering_at_rest(seen: Observation, car: Car) -> list[Finding]:
    average, primary, secondary = (_mean(seen, f"steering_motor{which}") for which in ("", "_primary", "_secondary"))
    if average is None:
        return []
    centred = abs(average) <= CENTRE_MAX * car.vehicle.steering_ratio
    centre = _finding(
        "steering centre", centred, f"motor at {np.degrees(average):+.1f} deg",
        "turn the wheels straight ahead; if they are, the sensor's zero is off", Verdict.WARN,
    )  # fmt: skip
    if primary is None or secondary is None:
        return [centre]
    apart = abs(primary - secondary)
    agree = _finding(
        "steering sensors",
        apart <= car.sensors.steering_apart,
        f"{np.degrees(apart):.1f} deg apart",
        "one of the two sensors is off",
    )
    return [centre, agree]


def _states(seen: Observation) -> list[Finding]:
    """What car and race control say they are doing."""
    findings = []
    if (code := seen.newest("sys_state")) is not None:
        state = meanings(seen.signals.codes["sys_state"], SysState).get(int(code), SysState.UNKNOWN)
        detail = f"{code:.0f} ({state.name.lower()})"
        findings.append(Finding(area=AREA, name="sys_state", verdict=Verdict.INFO, detail=detail))
    _, beats = seen.series["heartbeat"]
    if beats.size >= MIN_SAMPLES // 2:
        beating = float(np.ptp(beats)) > 0
        detail = "beating" if beating else f"frozen at {beats[0]:.0f}"
        findings.append(
            _finding("race-control heartbeat", beating, detail, "base station or its radio link", Verdict.WARN)
        )
    return findings


def _position(seen: Observation, config: Config) -> list[Finding]:
    receiver = next(iter(config.car.receivers))
    latitude, longitude = (seen.newest(f"receiver.{receiver}.{name}") for name in ("latitude", "longitude"))
    if latitude is None or longitude is None:
        return []
    if latitude == longitude == 0.0:
        return [_finding("position", False, "0, 0: no fix", "antenna, sky", Verdict.WARN)]
    place = LocalMap(config.origin).to_map_radians(latitude, longitude)
    distance_km = math.hypot(*place) / 1e3
    detail = f"{np.degrees(latitude):.6f}, {np.degrees(longitude):.6f} deg, {distance_km:.2f} km from the map's origin"
    return [_finding("position", LocalMap.holds(*place), detail, "set [origin] to the track's", Verdict.WARN)]


def _wheels_agree(by_wheel: dict[str, Array]) -> list[Finding]:
    """No wheel sensor stands still or reads another unit."""
    means = {wheel: float(speed.mean()) for wheel, speed in by_wheel.items()}
    typical = float(np.median(list(means.values())))
    off = [wheel for wheel, mean in means.items() if abs(mean - typical) > WHEEL_SPREAD * max(typical, STANDING_SPEED)]
    detail = ", ".join(f"{wheel.upper()} {mean:.2f}" for wheel, mean in means.items()) + " m/s on average"
    return [_finding("wheel speeds", not off, detail, f"sensor of {', '.join(off).upper()}")]


def _speed_agrees(seen: Observation, time: Array, by_wheel: dict[str, Array], config: Config) -> list[Finding]:
    """Way by the wheels over way by the positions, which are averaged over a second to be free of their noise."""
    receiver = f"receiver.{next(iter(config.car.receivers))}"
    at, latitude = seen.series.get(f"{receiver}.latitude", NOTHING)
    if at.size < MIN_SAMPLES:
        return []
    longitude = seen.series[f"{receiver}.longitude"][1]
    places = np.array([LocalMap(config.origin).to_map_radians(*p) for p in zip(latitude, longitude, strict=True)])
    second = at.astype(int)
    whole = [second == s for s in np.unique(second)[1:-1]]
    if len(whole) < 2:
        return []
    steps = np.diff([places[s].mean(axis=0) for s in whole], axis=0)
    way = float(np.linalg.norm(steps, axis=1).sum())
    speed = np.mean(list(by_wheel.values()), axis=0)
    middle = (time > at[whole[0]].mean()) & (time < at[whole[-1]].mean())
    rolled = float(np.trapezoid(speed[middle], time[middle]))
    if max(way, rolled) < PUSHED_M:
        return []
    detail = f"{rolled:.1f} m by the wheels, {way:.1f} m by the positions"
    good, remedy = abs(rolled - way) <= SPEED_SPREAD * way, "unit or scale of the wheel speeds, or the position hangs"
    return [_finding("speed against positions", good, detail, remedy)]


def _signs(seen: Observation, imu: str, time: Array, by_wheel: dict[str, Array], vehicle: Vehicle) -> list[Finding]:
    """Signs of yaw rate, steering and longitudinal acceleration against the wheels."""
    speed = np.mean(list(by_wheel.values()), axis=0)
    yaw = _resampled(seen, f"{imu}.yaw_rate", time)
    steer = _resampled(seen, "steering_motor", time)
    ax = _resampled(seen, f"{imu}.ax", time)
    findings = []
    if yaw is not None and float(np.abs(yaw).max()) > YAW_SEEN:
        turning = (by_wheel["rr"] - by_wheel["rl"]) / vehicle.track_rear
        findings.append(
            _sign("yaw rate against wheels", yaw, turning, time, "wheels left and right swapped, or sign of the yaw")
        )
        if steer is not None:
            steered = speed * np.tan(steer / vehicle.steering_ratio)
            findings.append(
                _sign("yaw rate against steering", yaw, steered, time, "sign of the steering angle or of the yaw rate")
            )
    smooth = np.convolve(speed, np.full(15, 1 / 15), mode="same")
    gained = np.gradient(smooth, time) if np.ptp(time) > 0 and np.all(np.diff(time) > 0) else np.zeros_like(speed)
    if ax is not None and float(np.abs(gained[15:-15]).max(initial=0.0)) > ACCELERATION_SEEN:
        change = ax[15:-15] - ax[15:-15].mean()
        remedy = "the x axis points backwards, or the car was pushed backwards"
        gain = gained[15:-15] - gained[15:-15].mean()
        findings.append(_sign("acceleration against wheels", change, gain, time[15:-15], remedy))
    if not findings:
        remedy = "push harder, around a bend"
        findings.append(
            Finding(area=AREA, name="signs", verdict=Verdict.INFO, detail="too little movement to tell", remedy=remedy)
        )
    return findings


def _sign(name: str, a: Array, b: Array, time: Array, remedy: str) -> Finding:
    """Two signals that must go up and down together; nothing is told where chance could do as much."""
    scale = float(np.sqrt(np.sum(a * a) * np.sum(b * b)))
    together = float(np.sum(a * b)) / scale if scale > 0 else 0.0
    independent = max(float(np.ptp(time)) / PUSH_S, 1.0)
    detail = f"correlation {together:+.2f}"
    if abs(together) < min(CHANCE / np.sqrt(independent), 0.9):
        detail, remedy = f"{detail}: chance could do as much", "push longer, around bends, faster and slower"
        return Finding(area=AREA, name=name, verdict=Verdict.INFO, detail=detail, remedy=remedy)
    return _finding(name, together > 0, detail, remedy)


def _resampled(seen: Observation, signal: str, time: Array) -> Array | None:
    """A signal at other times, by linear interpolation."""
    at, values = seen.series[signal]
    return np.interp(time, at, values) if at.size >= MIN_SAMPLES else None
