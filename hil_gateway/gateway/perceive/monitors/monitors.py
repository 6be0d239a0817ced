"""All monitors of sensors and actuators: measures for the failsafe table, once a period."""

from __future__ import annotations

from hil_gateway.bus.messages import VehicleState
from hil_gateway.car.actuation import Actuators
from hil_gateway.car.states import SysState
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.dead_reckoning import Pose
from hil_gateway.gateway.perceive.monitors.actuators import AccelerationMonitor, FollowingMonitor
from hil_gateway.gateway.perceive.monitors.position import PositionMonitor
from hil_gateway.gateway.perceive.monitors.road import RoadMonitor
from hil_gateway.gateway.perceive.monitors.sensors import GyroMonitor, LateralMonitor, SpeedChangeMonitor, WheelMonitor
from hil_gateway.gateway.perceive.motion import MotionReader
from hil_gateway.gateway.perceive.road_speed import STANDSTILL
from hil_gateway.track.track import Track

INFINITE = float("inf")
IMU_MEASURES = ("yaw_rate_wrong", "acceleration_wrong", "commands_unanswered")
"""contradictions in which the IMU may be the one that is wrong"""
IMU_WRONG_S = 0.1
"""s of contradiction after which the IMU is replaced by wheels and steering"""


class Monitors:
    """One of each; `measures` gives measure -> seconds it has held."""

    def __init__(self, config: Config, track: Track | None) -> None:
        vehicle = config.vehicle
        self.motion = MotionReader(vehicle)
        self.position = PositionMonitor()
        self._wheels = WheelMonitor(vehicle)
        self._gyro = GyroMonitor(vehicle)
        self._lateral = LateralMonitor()
        self._speed_change = SpeedChangeMonitor()
        self._following = FollowingMonitor(vehicle)
        self._acceleration = AccelerationMonitor(vehicle, config.powertrain.brake_force_per_pa)
        self.imu_wrong = self.imu_suspect = False
        self._road = None if track is None else RoadMonitor(track)

    @property
    def fixes_fit(self) -> bool:
        """Whether fixes are believed; where the IMU is contradicted too, it is the IMU that they did not fit."""
        return self.imu_wrong or not self.position.suspect

    def measures(
        self, now_ns: int, state: VehicleState, pose: Pose | None, commanded: Actuators | None
    ) -> dict[str, float]:
        """`commanded` is what stands on the wire, None while nothing is sent; after `motion` and `position`."""
        speed = self.motion.motion.speed
        imu, wheels = state.sources["imu"].valid, state.sources["wheel_speeds"].valid
        obeyed = commanded if state.sys_state == SysState.DRIVING else None
        follows = self._following.step(now_ns, state, obeyed)
        off, against = (0.0, 0.0) if self._road is None else self._road.step(now_ns, pose)
        rear = self.motion.rear_yaw_rate(state, speed)
        measures = {
            "position_wrong": INFINITE if self.position.wrong else 0.0,
            "position_lost": self.position.lost_s,
            "wheel_speed_wrong": self._wheels.step(now_ns, state, self.motion.motion) if wheels else 0.0,
            "yaw_rate_wrong": self._gyro.step(now_ns, state, speed, rear) if imu and wheels else 0.0,
            "acceleration_wrong": self._imu_accelerations(now_ns, state, speed) if imu and wheels else 0.0,
            "steering_stuck": follows.steering,
            "pedals_stuck": follows.pedals,
            "commands_unanswered": self._acceleration.step(now_ns, state, speed, obeyed if imu else None),
            "off_road": off,
            "wrong_way": against,
        }
        self._distrust(measures)
        return measures

    def _imu_accelerations(self, now_ns: int, state: VehicleState, speed: float) -> float:
        lateral = self._lateral.step(now_ns, state, speed)
        return max(lateral, self._speed_change.step(now_ns, state, speed))

    def _distrust(self, measures: dict[str, float]) -> None:
        """From a first contradiction on no estimate is believed; after some of it, no IMU until the car stands."""
        contradicted = [measures[name] for name in IMU_MEASURES]
        self.imu_wrong = max(contradicted) > IMU_WRONG_S or (self.imu_wrong and self.motion.motion.speed > STANDSTILL)
        self.motion.believe_imu = not self.imu_wrong
        self.imu_suspect = self.imu_wrong or max(contradicted) > 0.0
