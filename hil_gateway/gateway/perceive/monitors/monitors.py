"""All monitors of sensors and actuators: measures for the failsafe table, once a period."""

from __future__ import annotations

from typing import NamedTuple

from hil_gateway.bus.latest import Latest
from hil_gateway.bus.messages import Estimate, VehicleState
from hil_gateway.car.actuation import ActuatorPositions
from hil_gateway.car.states import SysState
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.course import OLDEST_S, Course
from hil_gateway.gateway.perceive.dead_reckoning import Pose
from hil_gateway.gateway.perceive.duration import CONTRADICTED_S, SILENT_S, ConditionTime
from hil_gateway.gateway.perceive.gyro_repair import GyroRepair
from hil_gateway.gateway.perceive.inbox import usable
from hil_gateway.gateway.perceive.monitors.actuators import AccelerationMonitor, FollowingMonitor, ReversedMonitor
from hil_gateway.gateway.perceive.monitors.course import CourseMonitor, SteadyCourse, TurnWitness
from hil_gateway.gateway.perceive.monitors.imu import ImuMonitor
from hil_gateway.gateway.perceive.monitors.position import PositionMonitor
from hil_gateway.gateway.perceive.monitors.road import RoadMonitor
from hil_gateway.gateway.perceive.monitors.sensors import AxleMonitor, SpeedChangeMonitor
from hil_gateway.gateway.perceive.monitors.wheels import LockedWheels, WheelMonitor
from hil_gateway.gateway.perceive.motion import Judged, MotionReader, second_fastest
from hil_gateway.gateway.perceive.road_speed import STANDSTILL
from hil_gateway.observer.observer import Observer
from hil_gateway.track.track import Track

INFINITE = float("inf")
IMU_MEASURES = ("yaw_rate_wrong", "acceleration_wrong", "commands_unanswered")
"""contradictions in which the IMU may be the one that is wrong"""

STEERS = (SysState.DRIVING, SysState.EMERGENCY)
"""in which the car follows steering commands"""


class SensorMonitors(NamedTuple):
    """Seconds that the IMU has been off what all others say, and that wheel speeds, yaw rate and acceleration have been
    contradicted; whether all wheels are faster or slower than fixes and IMU say, or fell faster than brakes make them;
    whether fixes say anything, and whether steering and wheels side with them."""

    imu_off: float
    wheels: float
    yaw_rate: float
    acceleration: float
    slipping: bool
    fixes: bool
    outvoted: bool


class Monitors:
    """One of each; `measures` gives measure -> seconds it has held."""

    def __init__(self, config: Config, track: Track | None) -> None:
        car = config.declared_car
        self.motion = MotionReader(car)
        self.position = PositionMonitor(config.placing.noise)
        self._wheels = WheelMonitor(config)
        self._axles = AxleMonitor(config)
        self._imu = ImuMonitor(car)
        self._observer = Observer(config)
        self._imu_off, self._wheels_off = ConditionTime(), ConditionTime()
        self._repair: GyroRepair | None = None
        self._steady = SteadyCourse()
        self._course = CourseMonitor()
        self._witness = TurnWitness()
        self._speed_change = SpeedChangeMonitor()
        self._locked = LockedWheels(config)
        self._following = FollowingMonitor(car)
        self._reversed = ReversedMonitor(car)
        self._acceleration = AccelerationMonitor(car)
        self.imu_wrong = self.imu_suspect = self.wheels_wrong = False
        self._stopping = self._flat = False
        self._steering_off = self._steering_doubted = False
        """whether the steering does not report what it is asked for: now, or since a stop began"""
        self._imu_gone, self._imu_missed = False, ConditionTime()
        """whether it alone was silent or implausible during this stop: where it comes back it may be late"""
        self._estimate_gone = False
        """whether there was none during this stop: what comes back has a gap, which what is reckoned has not"""
        self._without_wheels, self._without_imu = ConditionTime(), ConditionTime()
        """a source that is not believed any more stops the car, whatever it says from then on"""
        self._road = None if track is None else RoadMonitor(track, car.vehicle.half_width)

    @property
    def fixes_fit(self) -> bool:
        """Whether fixes are believed; where the IMU is contradicted too, it is the IMU that they did not fit."""
        return self.imu_wrong or not self.position.suspect

    @property
    def blind(self) -> bool:
        """Whether no fixes hold the pose: wrong, or none for `OLDEST_S`."""
        return self.position.lost_s > OLDEST_S or (self.position.wrong and not self.imu_wrong)

    @property
    def estimate_fits(self) -> bool:
        """Whether nothing that an estimate is made of is contradicted, and it was there during all of a stop."""
        return self.fixes_fit and not (self.imu_suspect or self.wheels_wrong or self._estimate_gone)

    @property
    def steering_reversed(self) -> bool:
        """Whether the steering goes to the other side than its command."""
        return self._reversed.found

    @property
    def shares(self) -> dict[str, float]:
        """Difference over bound of the monitors that compare with one, in this period."""
        own = {
            "IMU, all others": self._observer.imu_off,
            "wheels, all others": self._observer.wheels_off,
            "change of speed": self._speed_change.share,
        }
        return own | {f"course, {name}": share for name, share in self._course.shares.items()}

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
        is reported flat: its wheel turns at another speed, and pulls to its side."""
        self._stopping, self._flat = stopping, flat
        self._imu.step(state, self.motion.motion.speed)
        self._miss(now_ns, state)
        speed, imu = self.motion.motion.speed, self._reports(state)
        obeyed = commanded if state.sys_state == SysState.DRIVING else None
        follows = self._following.step(now_ns, state, obeyed)
        self._steering_off = follows.steering > 0.0
        self._reversed.step(state, speed, commanded if state.sys_state in STEERS else None)
        off, against = (0.0, 0.0) if self._road is None else self._road.step(now_ns, pose)
        sensors = self._compare(now_ns, state, course)
        measures = {
            "position_wrong": INFINITE if self.position.wrong or self.position.refused else 0.0,
            "position_lost": self.position.lost_s,
            "wheel_speed_wrong": sensors.wheels,
            "yaw_rate_wrong": sensors.yaw_rate,
            "acceleration_wrong": sensors.acceleration,
            "steering_stuck": follows.steering,
            "pedals_stuck": follows.pedals,
            "commands_unanswered": self._acceleration.step(now_ns, state, speed, obeyed if imu else None),
            "off_road": off,
            "wrong_way": against,
        }
        self._distrust(max(measures[name] for name in IMU_MEASURES), sensors)
        distrusted = {
            "wheel_speed_wrong": self._without_wheels.update(self.wheels_wrong, now_ns),
            "yaw_rate_wrong": self._without_imu.update(self.imu_wrong, now_ns) + CONTRADICTED_S * self.imu_wrong,
        }
        return measures | {name: max(measures[name], held_s) for name, held_s in distrusted.items()}

    def _compare(self, now_ns: int, state: VehicleState, course: Course | None) -> SensorMonitors:
        """IMU, wheels, steering and the course of the fixes with each other."""
        speed, steered = self.motion.motion.speed, self.motion.steered
        rear = self.motion.rear_yaw_rate(state, speed)
        ay = state.ay - (0.0 if self._road is None else self._road.gravity_across)
        wheels = state.sources["wheel_speeds"].valid
        both = wheels and self._reports(state)
        compared = both and not self._flat
        steady = self._steady.step(course)
        trusted = None if self.position.wrong and not self.imu_wrong else steady
        inertial = state.yaw_rate, ay
        known = trusted if both else None
        contradicted = self._course.step(now_ns, inertial, second_fastest(state), (rear, steered), known)
        self.position.contradicted(contradicted.position)
        changes = self._speed_change.step(now_ns, state, speed) if both else 0.0
        swapped = self._axles.step(now_ns, state, speed) if compared else 0.0
        imu_off, sided = self._observe(now_ns, state, speed)
        one_differs = self._wheels.step(now_ns, state, self.motion.motion) if wheels else 0.0
        locked = self._locked.step(state, speed)
        rates = state.yaw_rate, self.motion.wheel_yaw_rate(state, speed), steered
        return SensorMonitors(
            imu_off=imu_off,
            wheels=max(one_differs, swapped, sided),
            yaw_rate=INFINITE if self._imu_false else max(imu_off, contradicted.yaw_rate),
            acceleration=max(changes, contradicted.acceleration),
            slipping=(wheels and self._wheels.all_fell) or (changes > 0.0 and contradicted.wheels > 0.0 and not locked),
            fixes=trusted is not None,
            outvoted=self._witness.step(rates, steady if compared else None, self.position.suspect),
        )

    def _observe(self, now_ns: int, state: VehicleState, speed: float) -> tuple[float, float]:
        """Seconds that the IMU, and the wheels of both axles, have been off what all others say."""
        observer, across = self._observer, 0.0 if self._road is None else self._road.gravity_across
        self._steering_doubted = speed > 0.0 and (self._steering_off or (self._stopping and self._steering_doubted))
        observer.step(state, speed, across, known=not (self._flat or self._steering_doubted or self._imu_gone))
        imu_off = self._imu_off.update(observer.imu_off > 1.0, now_ns)
        if not (imu_off or self.imu_wrong):
            self._repair = None
        elif self._repair is None and (signs := observer.signs()) is not None:
            self._repair = GyroRepair(sign=signs[0], force=signs[1])
        return imu_off, self._wheels_off.update(observer.wheels_off > 1.0, now_ns)

    def _reports(self, state: VehicleState) -> bool:
        """Whether the IMU is there, and was during all of a stop."""
        return state.sources["imu"].valid and not self._imu_gone

    @property
    def _imu_false(self) -> bool:
        """Whether the IMU has shown by itself that it no longer measures."""
        return self._imu.found

    def _miss(self, now_ns: int, state: VehicleState) -> None:
        """An IMU that is gone while the wheels go on reporting."""
        alone = state.sources["wheel_speeds"].valid and not state.sources["imu"].valid
        held_s = self._imu_missed.update(alone, now_ns)
        self._imu_gone = self._imu_false or (self._stopping and (self._imu_gone or held_s > SILENT_S))

    def _distrust(self, held_s: float, sensors: SensorMonitors) -> None:
        """From a first contradiction of the IMU, which has `held_s`, no estimate is believed; after some of it, until
        the car stands, no IMU where there are fixes to go by, or no wheels where it is they that neither the fixes nor
        the IMU agree with. A gyro that is outvoted is what made the fixes not fit. It stays believed in a car that
        slides as it steers to the wrong side first, which the gyro has shown, or as a tyre is flat: a slide contradicts
        everything, and without a gyro nothing catches it."""
        moving = self.motion.motion.speed > STANDSTILL
        self.wheels_wrong = moving and (self.wheels_wrong or (sensors.slipping and not self.imu_wrong))
        slides = self.steering_reversed or self._flat
        held_s = 0.0 if slides else held_s
        outvoted = sensors.outvoted and not slides
        held = max(sensors.imu_off, held_s if sensors.fixes else 0.0) > CONTRADICTED_S and not slides
        found = outvoted or held
        self.imu_wrong = moving and (self.imu_wrong or (found and not self.wheels_wrong))
        self.motion.judged = Judged(
            not self.imu_wrong and not self._imu_gone, not self.wheels_wrong, self.imu_wrong,
            self._imu.repair or self._repair, self._observer.steer_zero, self._stopping,
        )  # fmt: skip
        self.imu_suspect = self.imu_wrong or self._imu_gone or held_s > 0.0
