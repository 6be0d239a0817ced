"""Transmission to the bus: declared identifiers and lengths only, rolling counters, one frame of each a period.

There is no thread and no kernel timer behind the counters: when the process hangs they stop, and the car sees it.
"""

from __future__ import annotations

from collections.abc import Mapping

from can_dbc.codec import Codec
from hil_gateway.can_link import CanLink
from hil_gateway.car.states import CtState
from hil_gateway.gateway.act.limits import RawCommand
from hil_gateway.gateway.decide.ladder_inputs import Flags

TRANSMITTED = (
    "brake_pressure_cmd",
    "accelerator_cmd",
    "steering_cmd",
    "gear_shift_cmd",
    "ct_report",
    "ct_report_2",
)
"""The white-list: no other message ever leaves."""


class Transmitter:
    """Frames of the computer, counted."""

    def __init__(self, codec: Codec, link: CanLink, vehicle_number: int) -> None:
        self._codec = codec
        self._link = link
        self._vehicle_number = vehicle_number
        self._allowed = {codec.messages[name].id: codec.messages[name].dlc for name in TRANSMITTED}
        self._counters = dict.fromkeys(TRANSMITTED, 0)
        self._report_due_ns = 0
        self._reported: tuple[int, ...] = ()
        self.refused = 0
        self.failed = 0

    def may_send(self, frame_id: int, data: bytes) -> bool:
        """Whether the white-list has this identifier with this length."""
        return self._allowed.get(frame_id) == len(data)

    def send(self, frame_id: int, data: bytes) -> bool:
        """Send one frame if the white-list has it; False is counted."""
        if not self.may_send(frame_id, data):
            self.refused += 1
            return False
        sent = self._link.send(frame_id, data)
        self.failed += not sent
        return sent

    def actuators(self, command: RawCommand, before: RawCommand) -> tuple[RawCommand, bool]:
        """The four actuator frames of one period: what now stands on the wire, and whether all of it left.

        A frame that could not be sent leaves its values and its counter as they were `before`, so that the next one
        continues from what the car has really received.
        """
        steering = {
            "steering_motor_ang_cmd": command.steering_motor,
            "driver_steering_P_cmd": 0,
            "driver_steering_I_cmd": 0,
            "driver_steering_D_cmd": 0,
            "driver_steering_FF_cmd": 0,
        }
        brakes = {"F_brake_pressure_cmd": command.brake_front, "R_brake_pressure_cmd": command.brake_rear}
        steered = self._message("steering_cmd", steering)
        braked = self._message("brake_pressure_cmd", brakes)
        pushed = self._message("accelerator_cmd", {"acc_pedal_cmd": command.accelerator})
        shifted = self._message("gear_shift_cmd", {"desired_gear": command.gear})
        left = RawCommand(
            command.steering_motor if steered else before.steering_motor,
            command.accelerator if pushed else before.accelerator,
            command.brake_front if braked else before.brake_front,
            command.brake_rear if braked else before.brake_rear,
            command.gear if shifted else before.gear,
        )
        return left, steered and braked and pushed and shifted

    def race_control(self, now_ns: int, ct_state: CtState, flags: Flags) -> None:
        """State and acknowledged flags, on every change and once a period."""
        content = (int(ct_state), *flags)
        if now_ns < self._report_due_ns and content == self._reported:
            return
        self._reported = content
        self._report_due_ns = now_ns + round(self._codec.messages["ct_report"].period_s * 1e9)
        vehicle, track, marelli_track, marelli_vehicle, marelli_sector = flags
        report = {
            "veh_sig_ack": vehicle,
            "track_cond_ack": track,
            "ct_state": ct_state,
            "veh_num": self._vehicle_number,
        }
        self._message("ct_report", report)
        acknowledged = {
            "marelli_track_flag_ack": marelli_track,
            "marelli_vehicle_flag_ack": marelli_vehicle,
            "marelli_sector_flag_ack": marelli_sector,
        }
        self._message("ct_report_2", acknowledged)

    def _message(self, name: str, raw: Mapping[str, int]) -> bool:
        """Add the counter, pack, send: the integers that were checked are those in the bytes."""
        layout = self._codec.messages[name]
        if layout.counter is None:
            return self.send(*self._codec.pack(name, raw))
        sent = self.send(*self._codec.pack(name, {**raw, layout.counter.signal: self._counters[name]}))
        self._counters[name] = (self._counters[name] + sent) % layout.counter.modulus
        return sent
