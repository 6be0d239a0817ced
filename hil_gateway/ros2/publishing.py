"""From the bus and the CAN cable to ROS: what has arrived since the last step, where somebody subscribes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from hil_gateway.bus import topics
from hil_gateway.bus.interface import Bus, LatestReader
from hil_gateway.bus.latest import Latest
from hil_gateway.bus.messages import Estimate, VehicleState
from hil_gateway.can_link import Frame
from hil_gateway.can_link.cdr import pack_frame
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.ros2 import topics as ros
from hil_gateway.ros2.outgoing import Level, Outgoing, Status, estimate_status, gateway_status, source_statuses
from hil_gateway.ros2.session import RosNode
from hil_gateway.ros2.topics import RosTopic
from hil_gateway.ros2.types import Types

QUEUE = 8
"""unread messages of a topic: 80 ms at 100 Hz"""
CAN = "can"
"""`header.frame_id` of frames, as ros2_socketcan has it"""


class Publishing:
    """Everything that goes out; `sent` counts it."""

    def __init__(self, bus: Bus, vehicle: Vehicle, types: Types, node: RosNode) -> None:
        self._node, self._types, self._vehicle = node, types, vehicle
        self._make = Outgoing(types)
        self._states = bus.subscribe(topics.VEHICLE_STATE, depth=QUEUE)
        self._estimates = bus.subscribe(topics.ESTIMATE, depth=QUEUE)
        self._plans = bus.subscribe(topics.PLAN, depth=QUEUE)
        self._gateway = LatestReader(bus, topics.GATEWAY_STATUS)
        self.state: Latest[VehicleState] = Latest(topics.VEHICLE_STATE.deadline_s)
        """the newest vehicle state"""
        self._estimate: Latest[Estimate] = Latest(topics.ESTIMATE.deadline_s)
        self._diagnostics_ns: int | None = None
        self.sent = 0

    def step(self, now_ns: int, unix_offset_ns: int, frames: list[Frame], further: tuple[Status, ...] = ()) -> None:
        """Pass on `frames` and what came on the bus; `further` rows go into the diagnostics."""
        self._unix_ns = now_ns + unix_offset_ns
        if self._node.wanted(ros.FRAMES):
            for frame in frames:
                self._publish(ros.FRAMES, pack_frame(frame, frame.stamp_ns + unix_offset_ns, CAN))
        for state in self._states.poll(now_ns):
            self.state.put(state, now_ns)
            self._pass_state(state, state.stamp_ns + unix_offset_ns)
        for estimate in self._estimates.poll(now_ns):
            self._estimate.put(estimate, now_ns)
            if estimate.valid:
                self._pass_estimate(estimate, estimate.state_stamp_ns + unix_offset_ns)
        for plan in self._plans.poll(now_ns):
            self._offer(ros.PLAN, self._make.path, plan, plan.state_stamp_ns + unix_offset_ns)
        self._diagnose(now_ns, further)

    def _pass_state(self, state: VehicleState, unix_ns: int) -> None:
        self._offer(ros.IMU, self._make.imu, state, unix_ns)
        for topic in ros.REPORTS:
            if self._node.wanted(topic):
                self._send(topic, self._make.report(topic, state, self._vehicle.steering_ratio, unix_ns))

    def _pass_estimate(self, estimate: Estimate, unix_ns: int) -> None:
        self._offer(ros.ODOMETRY, self._make.odometry, estimate, unix_ns)
        self._offer(ros.TF, self._make.car_in_map, estimate, unix_ns)

    def _diagnose(self, now_ns: int, further: tuple[Status, ...]) -> None:
        self._gateway.update(now_ns)
        if self._diagnostics_ns is None:
            self._send(ros.TF_STATIC, self._make.axles(self._vehicle.lf, self._vehicle.lr, self._unix_ns))
        elif now_ns < self._diagnostics_ns:
            return
        self._diagnostics_ns = now_ns + topics.GATEWAY_STATUS.period_ns
        self._offer(ros.DIAGNOSTICS, self._make.diagnostics, [*self._statuses(now_ns), *further], self._unix_ns)

    def _statuses(self, now_ns: int) -> Iterator[Status]:
        """Failsafe, estimate, every source; what has fallen silent is said to be."""
        gateway, state = self._gateway.latest, self.state
        if gateway.message is None or not gateway.alive(now_ns):
            yield "av24: failsafe", Level.STALE, f"the gateway is silent for {gateway.age_s(now_ns):.1f} s", []
        else:
            yield gateway_status(gateway.message)
        yield estimate_status(self._estimate.message, self._estimate.age_s(now_ns))
        if state.message is not None and state.alive(now_ns):
            yield from source_statuses(state.message)

    def _offer(self, topic: RosTopic, make: Callable[[Any, int], Any], message: Any, unix_ns: int) -> None:
        if self._node.wanted(topic):
            self._send(topic, make(message, unix_ns))

    def _send(self, topic: RosTopic, message: Any) -> None:
        self._publish(topic, self._types.to_bytes(topic.type, message))

    def _publish(self, topic: RosTopic, data: bytes) -> None:
        self._node.publish(topic, data, self._unix_ns)
        self.sent += 1
