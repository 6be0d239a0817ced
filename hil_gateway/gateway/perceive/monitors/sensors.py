"""Axles against each other, the gyro against wheels and steering, the IMU against the commanded force."""

from __future__ import annotations

import math
from collections import deque

from hil_gateway.bus.messages import VehicleState
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.monitors.held import Held
from hil_gateway.gateway.settings import PERIOD_S

JUDGED_FROM = 8.0
"""m/s: slower, differences of wheel speeds are within what parking manoeuvres and clutch make"""
PEDAL = 0.02
"""slip-ratio drive command from which they are in use"""
GYRO_RAD_S = 0.12
"""rad/s: gyro against wheels: 1 % of unequal slip left and right at 20 m/s, with the noise of both"""
GYRO_SHARE = 0.25
FORCE = 5.0
"""m/s2 lateral specific force may differ from v r: side slip that builds up (4.0), bias and noise (1.0)"""
STEERED = (0.3, 1.3)
"""yaw rate over v tan(delta) / L: from heavy understeer at top speed to slight oversteer"""
OVERSTEER = 0.001
"""rad of rear over front slip angle a m/s2 of lateral force: a car whose rear tyres are a third weaker than its front
ones takes a bend of 2.5 g with the wheels straight ahead (0.018 rad)"""


DRIVEN = 2.0
"""m/s2 by the engine from which the driven wheels' slip shows beside the noise of wheel speeds"""
DRIVE_SLIP = 0.0015
"""slip of the driven wheels a m/s2: a quarter of what slicks do (slip stiffness of 25 times the load on the axle that
carries 58 % of the car: 0.006); racing tyres twice as stiff do twice that"""
RADII = 0.03
"""that rolling radii front and rear may differ by: pressure, wear, growth with speed"""
ROLLING = 0.5
"""m/s2 by engine or brakes below which all wheels roll"""
ROLLED_S = 0.5
"""s of rolling in which the radii's ratio is learnt"""
SLIPPED_S = 0.1
"""time constant, s: noise of the wheel speeds (0.3 % of a sample)"""


class AxleMonitor:
    """Rear wheels, which the engine drives, turn faster than front wheels under power: else the axles are swapped.

    Front wheels roll on a path of their own in a bend: v cos(delta) + L r sin(delta) at the speed v of the rear axle.
    """

    def __init__(self, config: Config) -> None:
        self._vehicle = car = config.vehicle
        self._per_drive = config.powertrain.force_per_drive / car.mass
        self._drag = 0.5 * car.air_density * car.drag_area / car.mass
        self._radii = self._slip = 0.0
        """rear over front wheels' speed less 1: rolling, and lately"""
        self._held = Held()

    def step(self, now_ns: int, state: VehicleState, speed: float) -> float:
        """Seconds the driven wheels have turned slower."""
        if speed < JUDGED_FROM:
            self._slip = self._radii
            return self._held.update(False, now_ns)
        driven = self._per_drive * state.drive
        faster = self._rear_over_front(state) - 1.0
        if abs(driven) < ROLLING:
            self._radii += PERIOD_S / ROLLED_S * (min(max(faster, -RADII), RADII) - self._radii)
        self._slip += PERIOD_S / (SLIPPED_S + PERIOD_S) * (faster - self._slip)
        pushed = min(driven, state.ax + self._drag * speed**2)
        swapped = pushed > DRIVEN and self._slip - self._radii < -DRIVE_SLIP * pushed
        return self._held.update(swapped, now_ns)

    def _rear_over_front(self, state: VehicleState) -> float:
        rear = 0.5 * (state.wheel_speed_rl + state.wheel_speed_rr)
        front = 0.5 * (state.wheel_speed_fl + state.wheel_speed_fr)
        path = rear * math.cos(state.steer) + self._vehicle.wheelbase * state.yaw_rate * math.sin(state.steer)
        return path / max(front, 1.0)


class GyroMonitor:
    """The gyro outvoted by three of front wheels, rear wheels, steering and lateral force, all on one side of it.

    Each of them is wrong in some manoeuvre (a slide, a kerb), but not the same way: the yaw rate follows the steering,
    the force follows the yaw rate. Under the brakes the inner wheels of both axles slip more: then steering and force
    decide, and during a stop, which may lock wheels and slide, nobody.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._held = Held()
        self.share = 0.0
        """times their bounds, at least, that three of them are on one side of it"""

    def step(  # noqa: PLR0917 - what is compared
        self, now_ns: int, state: VehicleState, speed: float, rear: float, ay: float, stopping: bool
    ) -> float:
        """Seconds it has been outvoted; `rear` is the yaw rate by the rear wheels, rad/s, `ay` the lateral specific
        force without gravity, m/s2."""
        car, gyro = self._vehicle, state.yaw_rate
        steered = speed * math.tan(state.steer) / car.wheelbase
        front = (state.wheel_speed_fr - state.wheel_speed_fl) / (car.track_front * math.cos(state.steer))
        low, high = sorted(share * steered for share in STEERED)
        oversteer = OVERSTEER * ay * speed / car.wheelbase
        low, high = low + min(oversteer, 0.0), high + max(oversteer, 0.0)
        # a car at its limit that brakes into a fast bend turns in later than its force builds up
        forced, slack = ay / max(speed, JUDGED_FROM), max(FORCE / max(speed, JUDGED_FROM), GYRO_RAD_S)
        wheels = [(by_wheels - gyro) / (GYRO_RAD_S + GYRO_SHARE * abs(by_wheels)) for by_wheels in (front, rear)]
        above = [(low - gyro) / GYRO_RAD_S, (forced - gyro) / slack]
        below = [(gyro - high) / GYRO_RAD_S, (gyro - forced) / slack]
        if state.drive > -PEDAL:
            outvoted = max(sorted([*wheels, *above])[1], sorted([-wheels[0], -wheels[1], *below])[1])
        else:
            outvoted = 0.0 if stopping else max(min(above), min(below))
        self.share = max(outvoted, 0.0) if speed > JUDGED_FROM else 0.0
        return self._held.update(self.share > 1.0, now_ns)


SIDE_M_S, SIDE_SHARE = 1.0, 0.08
"""one side faster than the other beyond what the turn means: rolling radii (0.06 at most), slip of inner wheels"""


class SideMonitor:
    """The wheels of one side are faster than those of the other, on both axles, by more than the car turns.

    An axle may do so where a wheel spins; two do, and gyro and lateral force still agree, where sensors are wrong.
    Inner wheels that brake slip on both axles, and a stop may lock them: then nothing is judged.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._track = 0.5 * (vehicle.track_front + vehicle.track_rear)
        self._held = Held()

    def step(self, now_ns: int, state: VehicleState, speed: float, ay: float) -> float:
        """Seconds they have been; `ay` is the lateral specific force without gravity, m/s2."""
        if speed < JUDGED_FROM or state.drive < -PEDAL:
            return self._held.update(False, now_ns)
        turn = self._track * state.yaw_rate
        front, rear = state.wheel_speed_fr - state.wheel_speed_fl, state.wheel_speed_rr - state.wheel_speed_rl
        least = SIDE_M_S + SIDE_SHARE * speed
        apart = min(front, rear) - turn > least or turn - max(front, rear) > least
        return self._held.update(apart and abs(ay - speed * state.yaw_rate) < FORCE, now_ns)


SPEED_WINDOW = 50
"""periods (0.5 s) over which wheels and IMU must agree on the change of speed"""
SPEED_CHANGE, SPEED_CHANGE_SHARE = 1.0, 0.11
"""m/s in that time: gravity on a 10 % grade (0.5), bias and noise; and a share of the speed: slip of all wheels that
comes or goes. Healthy drives come to 0.45 of both together"""


class SpeedChangeMonitor:
    """Change of the wheels' speed against the integral of the longitudinal specific force, over half a second."""

    def __init__(self) -> None:
        self.share = 0.0
        """of the bound that they disagree by now"""
        self._speeds: deque[float] = deque(maxlen=SPEED_WINDOW)
        self._forces: deque[float] = deque(maxlen=SPEED_WINDOW)
        self._held = Held()

    def step(self, now_ns: int, state: VehicleState, speed: float) -> float:
        """Seconds they have disagreed."""
        self._speeds.append(speed)
        self._forces.append(state.ax)
        if len(self._speeds) < SPEED_WINDOW or min(self._speeds) < JUDGED_FROM:
            self.share = 0.0
        else:
            by_imu = sum(self._forces) * PERIOD_S
            bound = SPEED_CHANGE + SPEED_CHANGE_SHARE * self._speeds[0]
            self.share = abs(self._speeds[-1] - self._speeds[0] - by_imu) / bound
        return self._held.update(self.share > 1.0, now_ns)


ROLL_S = 0.05
"""s: an accelerometer on a body that rolls, behind its own filter, is so late; v r is made as late"""
LATERAL = 14.0
"""m/s2: side slip that swings in a car that weaves: 11.7 was the most on healthy drives, with the share below"""
LATERAL_SHARE = 0.35
"""of v r: the body's side slip in a slide"""


class LateralMonitor:
    """Lateral specific force against v r, with the gyro, as late as the force."""

    def __init__(self) -> None:
        self._held = Held()
        self._expected = 0.0
        self.share = 0.0
        """of the bound that they disagree by now"""

    def step(self, now_ns: int, state: VehicleState, speed: float, ay: float) -> float:
        """Seconds they have disagreed; `ay` is the force without gravity, m/s2."""
        self._expected += PERIOD_S / (ROLL_S + PERIOD_S) * (speed * state.yaw_rate - self._expected)
        expected = self._expected
        apart = abs(ay - expected) / (LATERAL + LATERAL_SHARE * abs(expected))
        self.share = apart if speed > JUDGED_FROM else 0.0
        return self._held.update(self.share > 1.0, now_ns)
