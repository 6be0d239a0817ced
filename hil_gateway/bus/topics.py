"""Every topic once: key, message, rate, deadline, whether it is recorded, priority.

The bus, the recorder, the dashboard, the watchdogs and the documentation are all driven by this table.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, TypeVar

from hil_gateway.bus import messages as m
from hil_gateway.bus.event import Event
from hil_gateway.bus.outside import Navigation, ReceiverStatus, Ros2Status
from hil_gateway.bus.playback import Playback
from hil_gateway.bus.proposal import ModelProposal
from hil_gateway.bus.race_line import RaceLine
from hil_gateway.bus.track_day.note import Note
from hil_gateway.bus.track_day.race_control import RaceControlRequest, RaceControlShown
from hil_gateway.bus.track_day.run import RunRequest, RunStatus
from hil_gateway.bus.tyres import Tyres
from hil_gateway.process.clock import NS_PER_S

M = TypeVar("M", bound=m.Message)


@dataclass(frozen=True)
class Topic(Generic[M]):
    """One stream of messages. `deadline_s` is the age beyond which a reader calls it dead."""

    key: str
    message: type[M]
    publisher: str
    rate_hz: float
    deadline_s: float
    recorded: bool = True
    priority: str = "data"
    max_bytes: int = 16_384
    """of one message; larger ones are counted and not parsed"""

    @cached_property
    def period_ns(self) -> int:
        """Between two messages, ns; of a topic with a rate."""
        return round(NS_PER_S / self.rate_hz)

    def __str__(self) -> str:
        return self.key


VEHICLE_STATE = Topic("av24/vehicle_state", m.VehicleState, "gateway", 100, 0.05, priority="real_time")
APPLIED = Topic("av24/applied", m.Applied, "gateway", 100, 0.05)
GATEWAY_STATUS = Topic("av24/gateway_status", m.GatewayStatus, "gateway", 10, 0.5)
TYRES = Topic("av24/tyres", Tyres, "gateway", 5, 1.0)
ESTIMATE = Topic("av24/estimate", m.Estimate, "estimator", 100, 0.05, priority="real_time")
BELIEF = Topic("av24/belief", m.Belief, "estimator", 10, 1.0, max_bytes=65_536)
MODEL_REVISION = Topic("av24/model_revision", m.ModelRevision, "estimator", 1, 3.0, max_bytes=65_536)
MODEL_PROPOSAL = Topic("av24/model_proposal", ModelProposal, "learner", 0.1, 600.0, max_bytes=65_536)
ALERT = Topic("av24/alert", m.Alert, "estimator", 1, 60.0)
PLAN = Topic("av24/plan", m.Plan, "planner", 20, 0.1, max_bytes=65_536)
RACE_LINE = Topic("av24/race_line", RaceLine, "planner", 0.2, 15.0, max_bytes=65_536)
COMMAND = Topic("av24/command", m.Command, "planner", 20, 0.1, priority="real_time")
ROS2_COMMAND = Topic("av24/ros2_command", m.Command, "ros2", 100, 0.1, priority="real_time")
JOYSTICK_COMMAND = Topic("av24/joystick_command", m.Command, "joystick", 100, 0.1, priority="real_time")
OPERATOR = Topic("av24/operator", m.OperatorCommand, "operator", 0, 1.0, priority="real_time")
RECORDER_STATUS = Topic("av24/recorder_status", m.RecorderStatus, "recorder", 1, 3.0)
PLAYBACK = Topic("av24/playback", Playback, "gateway", 5, 1.0, recorded=False)
EVENT = Topic("av24/event", Event, "gateway", 1, 60.0)
ROS2_STATUS = Topic("av24/ros2_status", Ros2Status, "ros2", 1, 3.0)
NAVIGATION = Topic("av24/navigation", Navigation, "receiver", 500, 0.2, priority="real_time")
RECEIVER_STATUS = Topic("av24/receiver_status", ReceiverStatus, "receiver", 1, 3.0)
TRUTH = Topic("referee/truth", m.Truth, "plant", 20, 1.0)
RACE_CONTROL = Topic("referee/race_control", RaceControlShown, "plant", 5, 1.0)
RUN = Topic("av24/run", RunStatus, "planner", 5, 1.0)
RUN_REQUEST = Topic("av24/run_request", RunRequest, "operator", 0, 1.0, max_bytes=65_536)
NOTE = Topic("av24/note", Note, "operator", 0, 60.0)
RACE_CONTROL_REQUEST = Topic("referee/race_control_request", RaceControlRequest, "operator", 0, 1.0)

TOPICS: tuple[Topic[Any], ...] = (
    VEHICLE_STATE,
    APPLIED,
    GATEWAY_STATUS,
    TYRES,
    ESTIMATE,
    BELIEF,
    MODEL_REVISION,
    MODEL_PROPOSAL,
    ALERT,
    PLAN,
    RACE_LINE,
    COMMAND,
    ROS2_COMMAND,
    JOYSTICK_COMMAND,
    OPERATOR,
    RECORDER_STATUS,
    TRUTH,
    EVENT,
    PLAYBACK,
    ROS2_STATUS,
    NAVIGATION,
    RECEIVER_STATUS,
    RACE_CONTROL,
    RACE_CONTROL_REQUEST,
    RUN,
    RUN_REQUEST,
    NOTE,
)
