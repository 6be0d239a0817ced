"""All monitors of sensors and actuators: measures for the failsafe table, once a period."""

from __future__ import annotations

import math
from typing import NamedTuple

from hil_gateway.bus.latest import Latest
from hil_gateway.bus.messages import Estimate, VehicleState
from hil_gateway.car.actuation import ActuatorPositions
from hil_gateway.car.states import STEERS, SysState
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.course import OLDEST_S, Course
from hil_gateway.gateway.perceive.dead_reckoning import Pose
from hil_gateway.gateway.perceive.duration import CONTRADICTED_S, SILENT_S, Comparison, ConditionTime
from hil_gateway.gateway.perceive.inbox import usable
from hil_gateway.gateway.perceive.monitors.actuators import AccelerationMonitor, FollowingMonitor, SteeringMonitor
from hil_gateway.gateway.perceive.monitors.imu import ImuMonitor
from hil_gateway.gateway.perceive.monitors.position import SHARE, PositionMonitor
from hil_gateway.gateway.perceive.monitors.road import RoadMonitor
from hil_gateway.gateway.perceive.motion import Judged, MotionReader, second_fastest
from hil_gateway.gateway.perceive.road_speed import STANDSTILL
from hil_gateway.observer.observer import SLOWEST, Observer
from hil_gateway.observer.steering import SteeringHypotheses
from hil_gateway.track.track import Track


class SensorMonitors(NamedTuple):
    """Seconds that the IMU has been off what all others say, that wheels have, and their speed has been off the one
    by IMU, engine and brakes; whether fixes say anything, and whether they contradict that speed, too."""

    imu: float
    wheels: float
    speed: float
    fixes: bool
    slipping: bool


class Monitors:
    """One of each; `measures` gives measure -> seconds it has held."""

    def __init__(self, config: Config, track: Track | None) -> None:
        car = config.declared_car
        self._observer = Observer(config)
        self.motion = MotionReader(car, self._observer)
        self.position = PositionMonitor(config.placing.noise)
        self._imu, self._wheel, self._speed, self._by_fixes = (Comparison() for _ in range(4))
        self._itself = ImuMonitor(car)
        self._following = FollowingMonitor(car)
        self._steering = SteeringMonitor(car)
        self._acceleration = AccelerationMonitor(car)
        self.imu_wrong = self.imu_suspect = self.wheels_wrong = self._wheels_apart = False
        self._imu_contradicted = False
        """whether the IMU is wrong by what other sensors say, so that it says nothing of the brakes"""
        self._stopping = self._flat = False
        self._steering_off = self._steering_doubted = False
        """whether the steering does not report what it is asked for: now, or since a stop began"""
        self._imu_gone, self._imu_missed = False, ConditionTime()
        """whether it no longer measures, or was silent or implausible alone in this stop: it may come back late"""
        self._estimate_gone = False
        """whether there was none during this stop: what comes back has a gap, which what is reckoned has not"""
        self._road = None if track is None else RoadMonitor(track, car.vehicle.half_width)

    @property
    def fixes_fit(self) -> bool:
        """Whether fixes are believed; where the IMU is contradicted too, it is the IMU that they did not fit."""
        return self.imu_wrong or not self.position.suspect

    @property
    def fix_fits(self) -> bool:
        """Whether the newest fix is believed: one that fits is, among others that do not, until they are wrong."""
        return self.fixes_fit or (self.position.fits and not self.position.wrong)

    @property
    def blind(self) -> bool:
        """Whether no fixes hold the pose: wrong, or none for `OLDEST_S`."""
        return self.position.lost_s > OLDEST_S or (self.position.wrong and not self.imu_wrong)

    @property
    def estimate_fits(self) -> bool:
        """Whether nothing that an estimate is made of is contradicted, and it was there during all of a stop."""
        return self.fixes_fit and not (self.imu_suspect or self.wheels_wrong or self._estimate_gone)

    @property
    def turns(self) -> SteeringHypotheses:
        """By which angle the car turns."""
        return self._observer.steering

    @property
    def steering_stands(self) -> bool:
        """Whether the steering's report does not move as it is asked to."""
        return self._steering.stands

    @property
    def steering_reversed(self) -> bool:
        """Whether the steering goes to the other side than its command."""
        return self._steering.found

    @property
    def shares(self) -> dict[str, float]:
        """Difference over bound of the monitors that compare with one, in this period."""
        return {
            "IMU, all others": self._imu.share,
            "steering": self.turns.off,
            "one wheel": self._wheel.share,
            "speed of the wheels": self._speed.share,
            "speed of the wheels, fixes": self._by_fixes.share,
        }

    def heed(self, now_ns: int, state: VehicleState, estimate: Latest[Estimate], reckoned: bool) -> None:
        """What an estimator thinks of the fixes counts while the sensors it judges them by are believed. `reckoned`:
        where the car is is known without its estimates, too."""
        follows = reckoned and self._stopping and self.motion.motion.speed > STANDSTILL
        self._estimate_gone = follows and (self._estimate_gone or not usable(estimate, now_ns))
        self.position.heed(now_ns, state, estimate, believed=not self.imu_suspect and not self.wheels_wrong)

    def measures(  # noqa: PLR0917 - what there is in a period
        self, now_ns: int, state: VehicleState, pose: Pose | None, commanded: ActuatorPositions | None,
        course: Course | None, stopping: bool = False, flat: bool = False,
    ) -> dict[str, float]:  # fmt: skip
        """`commanded` is what stands on the wire, None while nothing is sent; after `motion` and `position`. `course`
        is that of the fixes, None where they say nothing. Whether the car is being stopped already, and whether a tyre
        is flat."""
        self._stopping, self._flat = stopping, flat
        self._miss(now_ns, state)
        speed = self.motion.motion.speed
        obeyed = commanded if state.sys_state == SysState.DRIVING else None
        asked, keeps = commanded if state.sys_state in STEERS else None, stopping or self._steering_off
        self._steering.step(state, self.turns, speed, asked, self._observer.steer_zero, keeps)
        steering_s, pedals_s = self._following.step(now_ns, state, obeyed, self._steering.moves, self.turns.off > 1.0)
        self._steering_off = steering_s > 0.0
        off, against = (0.0, 0.0) if self._road is None else self._road.step(now_ns, pose)
        sensors = self._compare(now_ns, state, course)
        tells = state.sources["imu"].valid and not (self._imu_gone or self._imu_contradicted) and speed > SLOWEST
        unanswered_s = self._acceleration.step(now_ns, state.ax, self._following.obeyed if tells else ())
        self._distrust(sensors, unanswered_s)
        # a source that is not believed any more stops the car, whatever it says from then on
        return {
            "position_wrong": math.inf if self.position.wrong else 0.0,
            "position_lost": self.position.lost_s,
            "wheel_speed_wrong": math.inf if self.wheels_wrong else sensors.wheels,
            "yaw_rate_wrong": math.inf if self.imu_wrong else sensors.imu,
            "acceleration_wrong": sensors.speed,
            "steering_stuck": steering_s,
            "pedals_stuck": pedals_s,
            "commands_unanswered": unanswered_s,
            "off_road": off,
            "wrong_way": against,
        }

    def _compare(self, now_ns: int, state: VehicleState, course: Course | None) -> SensorMonitors:
        """Sensors with all others, and with the course of the fixes."""
        observer, wheels = self._observer, state.sources["wheel_speeds"].valid
        both = wheels and state.sources["imu"].valid and not self._imu_gone
        fixes = None if self.position.wrong and not self.imu_wrong else course
        off_s = self._imu.update(0.0 if self._excused(fixes) else observer.imu_off, now_ns)
        imu = math.inf if self._itself.found else off_s
        one = self._wheel.update(observer.wheel_off, now_ns)
        changes = self._speed.update(observer.speed_off if both else 0.0, now_ns)
        apart = 0.0
        if both and fixes is not None:
            apart = abs(second_fastest(state) - fixes.speed) / (SHARE * fixes.speed)
        by_fixes = self._by_fixes.update(apart, now_ns)
        return SensorMonitors(imu, one, changes, fixes is not None, min(changes, by_fixes) > 0.0)

    def _excused(self, fixes: Course | None) -> bool:
        """Whether what contradicts the IMU is itself contradicted: the wheels by all others, or all by the fixes."""
        if self._wheels_apart or not self._observer.imu_off > 1.0:  # as it nearly always is not
            return self._wheels_apart
        return fixes is not None and self.motion.fixes_favour_gyro(fixes)

    def _miss(self, now_ns: int, state: VehicleState) -> None:
        """An IMU that no longer measures, or is gone while the wheels go on reporting."""
        self._itself.step(state, self.motion.motion.speed)
        alone = state.sources["wheel_speeds"].valid and not state.sources["imu"].valid
        held_s = self._imu_missed.update(alone, now_ns)
        self._imu_gone = self._itself.found or (self._stopping and (self._imu_gone or held_s > SILENT_S))

    def _distrust(self, sensors: SensorMonitors, along_s: float) -> None:
        """From a first contradiction of the IMU, which has `along_s` along the car, no estimate is believed; after some
        of it, until the car stands, no IMU, or no wheels where it is they that neither the fixes nor the IMU agree
        with. Wheels that all others contradict first judge no IMU any more: the observer has heard them. The gyro stays
        believed in a car that slides as it steers to the wrong side first, which the gyro has shown, or as a tyre is
        flat: a slide contradicts everything, and without a gyro nothing catches it."""
        speed = self.motion.motion.speed
        moving, slides = speed > STANDSTILL, self.steering_reversed or self._flat
        self.wheels_wrong = moving and (self.wheels_wrong or (sensors.slipping and not self.imu_wrong))
        apart = sensors.wheels > CONTRADICTED_S and not self.imu_wrong
        self._wheels_apart = moving and (self._wheels_apart or apart)
        contradicted = sensors.imu > CONTRADICTED_S and not slides
        self._imu_contradicted = moving and (self._imu_contradicted or contradicted)
        found = contradicted or (sensors.fixes and along_s > CONTRADICTED_S and not slides)
        self.imu_wrong = moving and (self.imu_wrong or (found and not self.wheels_wrong))
        suspect = max(sensors.imu, along_s) > 0.0 and not slides
        self.imu_suspect = self.imu_wrong or self._imu_gone or suspect
        self._steering_doubted = speed > 0.0 and (self._steering_off or (self._stopping and self._steering_doubted))
        self.motion.judged = Judged(
            self.imu_wrong, not self.wheels_wrong, self._imu_gone, not self._flat, not self._steering_doubted,
            self._stopping, 0.0 if self._road is None else self._road.gravity_across,
        )  # fmt: skip
