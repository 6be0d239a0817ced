"""Messages on Zenoh and in recordings: one frozen Pydantic model each; their JSON is the wire format.

Frames: ISO 8855 (x forward, y left, z up; yaw, steering and lateral force positive to the left); SI units.
`ax`, `ay` are specific force at the centre of gravity. Positions are in the local map frame (x east, y north
of the configured origin). Stamps are monotonic nanoseconds of the sender.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from hil_gateway.bus.delivered import Delivered
from hil_gateway.process.model import Model

# Bounds far outside what a car can do: a number that has lost its meaning is refused where it arrives, and what
# is computed from the rest stays finite.
Reported = Annotated[float, Field(ge=-200, le=200)]
"""a speed, rate or acceleration as a sensor reports it"""
Motion = Annotated[float, Field(ge=-1e4, le=1e4)]
"""a speed or rate as it is estimated"""
Angle = Annotated[float, Field(ge=-1e4, le=1e4)]
Slip = Annotated[float, Field(ge=-100, le=100)]
Late = Annotated[float, Field(ge=0, le=1)]
Balance = Annotated[float, Field(ge=-1, le=1)]
Position = Annotated[float, Field(ge=-1e7, le=1e7)]
Pressure = Annotated[float, Field(ge=-1e8, le=1e8)]
Parameter = Annotated[float, Field(ge=-1e12, le=1e12)]
Stamp = Annotated[int, Field(ge=0, lt=1 << 63)]
"""monotonic nanoseconds"""
Code = Annotated[int, Field(ge=-(1 << 31), lt=1 << 31)]
"""a state, flag, gear or count: what any field of the wire can hold"""


Name = Annotated[str, Field(max_length=64)]
"""of a sender, a parameter, an effect, a layout: what is kept by name is bounded"""
Text = Annotated[str, Field(max_length=4000)]
"""for people"""
FilePath = Annotated[str, Field(max_length=4096)]
"""of a file, as long as Linux has them"""
Count = Annotated[int, Field(ge=0, lt=1 << 63)]
Deviation = Annotated[float, Field(gt=0, le=1e6)]
Errors = Annotated[dict[Name, Parameter], Field(max_length=64)]
"""by channel"""
Horizon = Field(max_length=400)
"""stages of a plan; a horizon has at most 200"""


def _square(matrix: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
    if any(len(row) != len(matrix) for row in matrix):
        raise ValueError("a covariance is square")
    return matrix


Covariance = Annotated[
    tuple[Annotated[tuple[Parameter, ...], Field(max_length=200)], ...], Field(max_length=200), AfterValidator(_square)
]


class Message(Model):
    """What every message carries."""

    stamp_ns: Stamp = Field(description="time of validity, sender's monotonic clock, ns")
    seq: int = Field(ge=0, lt=1 << 63, description="advances by one a message of this sender")


class Agreement(Model):
    """What processes that drive one car have to agree on: a name and a fingerprint of what is behind it."""

    track: Name
    car: Name


@dataclass(frozen=True, slots=True)
class SourceHealth:
    """One group of CAN messages behind the vehicle state."""

    __pydantic_config__ = Model.model_config
    age_s: Annotated[Parameter | None, Field(description="seconds since the last frame; null before the first")]
    valid: bool


class Heading(Model):
    """Where the car points, rad, in the map's axes: 0 east, positive to the left; std null where none is stated."""

    yaw: Angle
    std: Deviation | None


Lacks = Literal["", "start", "position", "heading"]
"""what the state filter does not know: anything yet (`start`), where the car is, where it points"""


ESTIMATED = ("x", "y", "yaw", "vx", "vy", "yaw_rate", "bias_ax", "bias_ay", "bias_yaw_rate")
"""what `Estimate.std` is of, in its order"""


class Estimate(Message):
    """Filtered vehicle state at the centre of gravity (100 Hz).

    `valid`: a plan may depend on all of it; the vehicle state is valid and the filter lacks nothing.
    `bias_ax`, `bias_ay`: all that is to be taken off what the accelerometers read, for bias, for the turn of their axes
    and for their distance to the centre of gravity.
    """

    state_stamp_ns: Stamp = Field(description="stamp of the VehicleState this answers, gateway clock")
    valid: bool
    x: Position
    y: Position
    yaw: Angle
    vx: Motion
    vy: Motion
    yaw_rate: Motion
    bias_ax: Motion
    bias_ay: Motion
    bias_yaw_rate: Motion
    std: tuple[Parameter, ...] = Field(
        min_length=len(ESTIMATED),
        max_length=len(ESTIMATED),
        description="standard deviations of x, y, yaw, vx, vy, yaw_rate, biases",
    )
    grade_share: Reported = Field(default=1.0, description="share of the track map's grade that is real")
    bank_share: Reported = Field(default=1.0, description="the same of its bank")
    steer: Angle = Field(description="road-wheel angle as the car reports it, rad")
    steer_late: Late = Field(default=0.0, description="by which the road wheels follow it, s, see VehicleState")
    drive: Slip = Field(description="slip-ratio drive command equivalent to the reported pedals")
    innovations_rejected: Count = Field(description="measurements gated out since start")
    delivered: Delivered | None = Field(default=None, description="what tyres and brakes give of what is believed")
    lacks: Lacks = Field(default="", description="what makes it invalid, of what the state filter has to know")
    bridged: Count = Field(default=0, description="states predicted without an inertial sample, since start")
    agreement: Agreement | None = Field(default=None, description="track and car that the sender works with")

    @property
    def placed(self) -> bool:
        """Whether x, y and speed hold, by which laps are timed: also in the first metres of a car nobody has pushed."""
        return self.valid or self.lacks == "heading"


class VehicleState(Message):
    """What the car reports, decoded to SI, with the health of every source (100 Hz)."""

    valid: bool = Field(description="every source needed for driving is alive and plausible")
    sources: dict[Name, SourceHealth] = Field(max_length=64)
    imu: Name = Field(default="", description="the inertial sensor that is used, of those the car has")
    receiver: Name = Field(default="", description="the receiver that positions are from")
    ax: Reported
    ay: Reported
    az: Reported
    yaw_rate: Reported
    roll_rate: Reported
    wheel_speed_fl: Reported = Field(description="circumferential, m/s")
    wheel_speed_fr: Reported
    wheel_speed_rl: Reported
    wheel_speed_rr: Reported
    steer: Angle = Field(description="road-wheel angle, rad")
    steer_late: Late = Field(default=0.0, description="by which the road wheels follow it, as driving has shown, s")
    steer_rate: Reported
    accelerator: float = Field(ge=0, le=1)
    throttle: Slip = Field(description="engine throttle, 0..1")
    brake_front: Pressure = Field(description="Pa")
    brake_rear: Pressure = Field(description="Pa")
    drive: Slip = Field(description="slip-ratio drive command of Eq. (2) equivalent to the reported pedals")
    gear: Code
    engine_speed: Motion = Field(description="rad/s")
    position_x: Position
    position_y: Position
    position_seq: int = Field(ge=0, lt=1 << 63, description="advances when a new position fix arrived")
    position_stamp_ns: Stamp | None = Field(default=None, description="when it arrived; null: as old as the state")
    heading: Heading | None = Field(default=None, description="of the receiver; null where none has come")
    sys_state: Code
    ct_state: Code
    track_flag: Code
    vehicle_flag: Code
    stood: Estimate | None = Field(
        default=None, description="last valid estimate, of a car that has stood since; null while there is a newer one"
    )

    @property
    def fix_ns(self) -> int:
        """When the car was at the position."""
        return self.stamp_ns if self.position_stamp_ns is None else self.position_stamp_ns


class Belief(Message):
    """Gaussian belief over the tyre parameters (Eq. 8)."""

    layout: Name = Field(description="shared | per_axle")
    names: tuple[Name, ...] = Field(max_length=200)
    mean: tuple[Parameter, ...] = Field(max_length=200)
    covariance: Covariance
    samples: Count = Field(description="samples that passed the activity gates")
    log_det_information: Parameter = Field(description="log det of the posterior precision in prior-scaled units")
    residual: tuple[Motion, Motion, Motion] | None = Field(
        default=None,
        description="measured minus expected ax, ay (m/s2) and yaw acceleration (rad/s2), mean since the last message",
    )

    @model_validator(mode="after")
    def _one_size(self) -> Self:
        if not len(self.names) == len(self.mean) == len(self.covariance):
            raise ValueError("names, mean and covariance are of different length")
        return self


class ActiveEffect(Model):
    """One effect added to the declared model, with its parameters in SI."""

    name: Name
    parameters: dict[Name, Parameter] = Field(max_length=64)
    profile: tuple[Parameter, ...] = Field(
        default=(), max_length=10_000, description="spline coefficients over track position, if any"
    )


class Provenance(Model):
    """Where a model revision comes from and what it improved."""

    sessions: tuple[Name, ...] = Field(
        default=(), max_length=1000, description="SHA-256 of each session it was learnt from"
    )
    error_before: Errors = Field(default={}, description="held-out RMSE per channel, before")
    error_after: Errors = Field(default={}, description="held-out RMSE per channel, after")
    note: Text = ""


class ModelRevision(Message):
    """The vehicle model the planner is to use: tyre parameters, belief, active effects, provenance."""

    revision: Name = Field(description="content hash of layout, tyre and effects")
    layout: Name
    tyre: dict[Name, Parameter] = Field(max_length=64)
    covariance: Covariance = ()
    effects: tuple[ActiveEffect, ...] = Field(default=(), max_length=64)
    provenance: Provenance = Provenance()


class PlanStatus(StrEnum):
    """How a plan came about."""

    SOLVED = "solved"
    SHIFTED = "shifted"
    STOP = "stop"
    FIRST_METRES = "first_metres"
    """straight ahead at walking pace, until it is known where the car points"""
    NOT_MOVING = "not_moving"
    """the car stands and goes on standing: `Plan.reason` says why"""


class Plan(Message):
    """Predicted motion over the horizon, stage 0 first; all arrays have the same length."""

    state_stamp_ns: Stamp
    status: PlanStatus
    reason: Text = Field(default="", description="why the plan is not a fresh solution")
    dt: float = Field(gt=0, le=10)
    x: Annotated[tuple[Position, ...], Horizon]
    y: Annotated[tuple[Position, ...], Horizon]
    yaw: Annotated[tuple[Angle, ...], Horizon]
    vx: Annotated[tuple[Motion, ...], Horizon]
    s: Annotated[tuple[Position, ...], Horizon]
    steer: Annotated[tuple[Angle, ...], Horizon]
    drive: Annotated[tuple[Slip, ...], Horizon]
    lap: Code
    revision: Name = Field(description="model revision the plan was made with")
    solve_ms: Parameter = Field(description="ms from reading the estimate to the command")
    information_gain: Parameter = Field(default=0.0, description="sum of Delta I over the horizon (Eq. 7)")
    agreement: Agreement | None = Field(default=None, description="track and car that the sender works with")

    @model_validator(mode="after")
    def _one_length(self) -> Self:
        if len({len(row) for row in (self.x, self.y, self.yaw, self.vx, self.s, self.steer, self.drive)}) > 1:
            raise ValueError("the arrays of a plan are of different length")
        return self


class Command(Message):
    """What the planner asks for (first action of the plan)."""

    source: Name
    state_stamp_ns: Stamp = Field(description="stamp of the VehicleState the plan started from, gateway clock")
    steer: Angle = Field(description="road-wheel angle, rad")
    drive: Slip = Field(description="slip ratio, positive drives, negative brakes")
    brake_balance: Balance | None = Field(
        default=None, description="front minus rear brake pressure over their sum; null: as declared"
    )


class OperatorAction(StrEnum):
    """What a person can ask of the gateway."""

    CRANK = "crank"
    ARM = "arm"
    DISARM = "disarm"
    STOP = "stop"
    EMERGENCY = "emergency"
    TAKE_OVER = "take-over"


class OperatorCommand(Message):
    """A person's request; cranking and arming are edge-triggered and never remembered."""

    source: Name
    action: OperatorAction


class FailsafeAction(StrEnum):
    """What the gateway does, in rising severity."""

    SILENT = "silent"
    DRIVE = "drive"
    CONTROLLED_STOP = "controlled_stop"
    EMERGENCY_STOP = "emergency_stop"


class Applied(Message):
    """What the gateway really sent this period, after every limit (100 Hz)."""

    sent: bool
    action: FailsafeAction
    limited: tuple[Name, ...] = Field(max_length=64, description="names of the limits that changed the request")
    steer: Angle
    drive: Slip
    accelerator_percent: Parameter
    brake_front_kpa: Parameter
    brake_rear_kpa: Parameter
    steering_motor_deg: Parameter
    gear: Code
    holding: bool = Field(default=False, description="the brakes hold the standing car, whatever a command asks for")


class GatewayStatus(Message):
    """Health of the gateway and of the bus (10 Hz)."""

    mode: Name = Field(description="listen | shadow | actuator_test | armed")
    armed: bool
    action: FailsafeAction
    cause: Text
    missing_for_arming: tuple[Text, ...] = Field(max_length=64)
    missing_for_crank: tuple[Text, ...] = Field(
        default=("unknown",), max_length=64, description="why a request to crank would be refused; empty: it is awaited"
    )
    advice: Annotated[dict[Name, Text], Field(max_length=64)] = Field(
        default={}, description="what to do about causes of `missing_for_arming`, where the table's words are not all"
    )
    holding: bool = Field(default=False, description="brakes alone are commanded, without arming")
    bus: Name
    bus_state: Name
    frames_received: Count
    frames_lost: Count
    frames_unknown: Count
    frames_malformed: Count
    counter_errors: Count
    commands_sent: Count
    commands_limited: Count
    loop_latency_p50_ms: Parameter | None
    loop_latency_p99_ms: Parameter | None
    detail: Text = Field(default="", description="who was late, for how long, load and remedy, if lateness stopped it")
    command_source: Name = Field(default="", description="who has the right to command; empty: nobody yet")
    second_source: Name = Field(default="", description="who sends commands that are refused for it, of late")


class Alert(Message):
    """The model has stopped explaining a channel (live monitor)."""

    channel: Name
    condition: Text = Field(description="where it fails, in words: 'right turns above 40 m/s'")
    suspected_effect: Name = ""
    strength: Parameter = Field(description="residual RMS over its noise floor")


class RecorderStatus(Message):
    """Health of the recording (1 Hz); whatever was not written is counted, never dropped in silence."""

    file: FilePath
    recording: bool
    frames: Count = Field(description="raw CAN frames written")
    messages: Count = Field(description="topic messages written")
    lost: Count = Field(description="frames and messages that arrived or should have, and were not written")
    errors: Count = Field(description="failed disk operations")
    last_error: Text = ""
    bytes_written: Count
    free_bytes: Count | None = Field(description="free space on the disk; null when it cannot be read")
    noted: Count = Field(default=0, description="number of the newest note that was written")


class Truth(Message):
    """The plant's own state and what its referees count (`hil_gateway/plant/referee/`). No node subscribes to it."""

    x: Parameter
    y: Parameter
    z: Parameter
    yaw: Parameter
    vx: Parameter
    vy: Parameter
    yaw_rate: Parameter
    s: Parameter
    lateral_offset: Parameter
    off_track: bool
    lap: Count
    lap_times_s: tuple[Parameter, ...] = Field(default=(), max_length=10_000)
    off_track_count: Count = 0
    friction_used: tuple[Parameter, Parameter] = (0.0, 0.0)
    friction_over_s: Parameter = 0.0
    slides: Count = 0
    spins: Count = 0
