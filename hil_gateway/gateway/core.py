"""The gateway: frames in, vehicle state out; commands in, limited and supervised frames out (100 Hz).

`step` is one period: perceive (frames, messages), decide (failsafe, race control), act (actuation, limits, frames),
report. It holds all its state, reads no clock and raises nothing but bugs.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from can_dbc.codec import Codec, load_codec
from hil_gateway.bus import topics
from hil_gateway.bus.interface import Bus, LatestReader
from hil_gateway.bus.messages import (
    Applied,
    FailsafeAction,
    GatewayStatus,
    OperatorAction,
    OperatorCommand,
    VehicleState,
)
from hil_gateway.can_link import CanLink
from hil_gateway.car.actuation import Actuation, Actuators
from hil_gateway.car.powertrain import GearChoice
from hil_gateway.car.states import CtState, SysState
from hil_gateway.config import Config
from hil_gateway.gateway.act import actuator_test
from hil_gateway.gateway.act.limits import Limits
from hil_gateway.gateway.act.stopping import Stopping
from hil_gateway.gateway.act.transmitter import Transmitter
from hil_gateway.gateway.decide.command_gate import CommandGate
from hil_gateway.gateway.decide.conditions import KILLS, Conditions
from hil_gateway.gateway.decide.failsafe import Failsafe, Inputs, missing_for_arming
from hil_gateway.gateway.decide.ladder_inputs import flags_heard, flags_in_force, heard
from hil_gateway.gateway.decide.race_control import Demand, RaceControl
from hil_gateway.gateway.perceive.dead_reckoning import DeadReckoning
from hil_gateway.gateway.perceive.road_speed import STANDSTILL, rear_speed, road_speed
from hil_gateway.gateway.perceive.vehicle_state import VehicleStateBuilder
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.held_up import who_was_late
from hil_gateway.process.rolling import Rolling
from hil_gateway.track.track import Track

STATUS_PERIOD_NS = NS_PER_S // 10
LATENCY_WINDOW = 1000
COMMAND_QUEUE = 16
OPERATOR_QUEUE = 1024
"""Requests of a period that are all looked at: no flood of others pushes out the one to stop."""
STOPPING = (FailsafeAction.CONTROLLED_STOP, FailsafeAction.EMERGENCY_STOP)
REQUESTS_REMEMBERED = 64


class Gateway:
    """Core of the gateway process.

    `track` lets a stop go on beyond the end of the last plan; `load` says, when asked, how busy the computer is.
    """

    def __init__(
        self, config: Config, bus: Bus, link: CanLink, track: Track | None = None, load: Callable[[], str] = str
    ) -> None:
        self._config = config
        self._bus = bus
        self._link = link
        codec: Codec = load_codec()
        self._actuation = Actuation(config.vehicle, config.powertrain)
        self._gears = GearChoice(config.powertrain, config.vehicle.wheel_radius)
        self._limits = Limits(codec, config.gateway.limits)
        self._stopping = Stopping(config.vehicle, config.gateway.stop, config.powertrain.force_per_drive, track)
        self._dead_reckoning = DeadReckoning()
        self._transmitter = Transmitter(codec, link, config.gateway.vehicle_number)
        self.builder = VehicleStateBuilder(config, codec, self._actuation)
        self._commands = bus.subscribe(topics.COMMAND, depth=COMMAND_QUEUE)
        self._operator = bus.subscribe(topics.OPERATOR, depth=OPERATOR_QUEUE)
        self._plan = LatestReader(bus, topics.PLAN)
        self._estimate = LatestReader(bus, topics.ESTIMATE)
        self._gate = CommandGate(config.gateway.command_latency_max_s)
        self.failsafe = Failsafe()
        self.race_control = RaceControl()
        self._testing = config.gateway.mode == "actuator_test"
        self._transmits = config.gateway.mode in ("armed", "actuator_test")
        self._restarting = False
        self._killed_by = ""
        self._load, self._detail = load, ""
        self._armed_ns = 0
        self._previous = self._limits.resting(0.0)
        self._conditions = Conditions(self.builder, self._testing)
        self._requests_seen: deque[tuple[str, int, int]] = deque(maxlen=REQUESTS_REMEMBERED)
        self._status_due_ns = 0
        self._seq = self._status_seq = 0
        self._latency_ms = Rolling(LATENCY_WINDOW)
        self._answered_seq: int | None = None
        self._sent = self._limited = 0
        self.refused: dict[str, int] = {}
        self.seen: tuple[VehicleState, Inputs] | None = None
        """what the newest period decided on"""

    def step(self, now_ns: int) -> None:
        """One 10 ms period."""
        self.builder.take(self._link.receive(0.0), now_ns)
        state = self.builder.build(now_ns, self.race_control.ct_state, *flags_in_force(self.builder, now_ns))
        self._bus.publish(topics.VEHICLE_STATE, state)
        request = self._read_messages(now_ns, state)
        inputs = self._inputs(now_ns, state, request)
        self.seen = state, inputs
        self._decide(now_ns, inputs, state)
        applied = self._act(now_ns, state)
        self._bus.publish(topics.APPLIED, applied)
        if now_ns >= self._status_due_ns:
            self._status_due_ns = now_ns + STATUS_PERIOD_NS
            self._bus.publish(topics.GATEWAY_STATUS, self._status(now_ns, inputs))
            self._status_seq += 1
        self._seq += 1

    def shut_down(self, now_ns: int) -> None:
        """Say controlled shutdown on the wire; the car stops by itself when the commands end."""
        if self._transmits:
            self._transmitter.race_control(now_ns, CtState.CONTROLLED_SHUTDOWN, flags_heard(self.builder))

    def _read_messages(self, now_ns: int, state: VehicleState) -> OperatorAction | None:
        """Take in commands, plan and estimate; the newest request of a person, if one arrived this period."""
        for command in self._commands.poll(now_ns):
            refusal = self._gate.offer(command, now_ns, self.failsafe.armed)
            if refusal is not None:
                self.refused[refusal] = self.refused.get(refusal, 0) + 1
        before = self._plan.latest.count
        plan = self._plan.update(now_ns)
        if plan.count != before and plan.message is not None:
            self._stopping.take_plan(plan.message, stopping=self.failsafe.action in STOPPING)
        estimate = self._estimate.update(now_ns)
        self._dead_reckoning.step(now_ns, state, estimate.message if estimate.valid(now_ns) else None)
        return strongest([message.action for message in self._operator.poll(now_ns) if self._is_new(message)])

    def _is_new(self, request: OperatorCommand) -> bool:
        """Whether a request is no second delivery: an old one must not arm again."""
        identity = (request.source, request.seq, request.stamp_ns)
        known = identity in self._requests_seen
        self._requests_seen.append(identity)
        return not known

    def _inputs(self, now_ns: int, state: VehicleState, request: OperatorAction | None) -> Inputs:
        measures = self._conditions.measures(
            now_ns,
            state,
            request,
            answers_for_motion=self.failsafe.armed or not self._transmits,
            command_age_s=self._gate.age_s(now_ns),
            estimate=self._estimate.latest,
            heartbeat_frozen_s=self.race_control.heartbeat_frozen_s(now_ns),
        )
        standing = state.valid and road_speed(state) < STANDSTILL
        return Inputs(measures, standing, request, may_arm=self._config.gateway.mode != "listen")

    def _decide(self, now_ns: int, inputs: Inputs, state: VehicleState) -> None:
        before = self.failsafe.action
        self.failsafe = self.failsafe.step(inputs)
        action = self.failsafe.action
        if before is FailsafeAction.SILENT:
            self._armed_ns = now_ns
        if action is not before:
            self._detail = self._explain(now_ns, inputs)
        if action in STOPPING and before not in STOPPING:
            self._stopping.start(self._actuation.to_steer(self._limits.to_actuators(self._previous).steering_motor))
        ct_state = self.race_control.ct_state
        if inputs.request is OperatorAction.DISARM and inputs.standing:
            # the car misses our commands and goes into its own emergency: both begin anew
            self._restarting |= before is not FailsafeAction.SILENT or ct_state is CtState.EMERGENCY
        elif state.sources["vehicle"].valid and state.sys_state <= SysState.CONNECTED:
            self._restarting = False
        kills = [measure for measure in KILLS if inputs.measures[measure] > 0]
        self._killed_by = kills[0] if kills else self._killed_by
        killed = bool(kills)
        killed |= inputs.measures["car_emergency"] > 0 and ct_state > CtState.INIT and not self._restarting
        demand = Demand(
            stop=action is FailsafeAction.CONTROLLED_STOP,
            emergency=action is FailsafeAction.EMERGENCY_STOP or killed,
            restart=self._restarting,
            armed=action is FailsafeAction.DRIVE,
            highest=CtState.ACTUATOR_TEST if self._testing else CtState.NOMINAL_RACE,
        )
        self.race_control = self.race_control.step(now_ns, heard(self.builder, now_ns, state), demand)

    def _explain(self, now_ns: int, inputs: Inputs) -> str:
        """Who was late and how busy the computer is, where that is why the car is being stopped."""
        ages = {**inputs.measures, "estimate_age": self._estimate.latest.age_s(now_ns)}
        late = who_was_late(self.failsafe.cause, ages)
        return "; ".join(filter(None, (late, self._load()))) if late else ""

    def _act(self, now_ns: int, state: VehicleState) -> Applied:
        """Send this period's frames; what really left goes into `Applied`."""
        if self._transmits:
            self._transmitter.race_control(now_ns, self.race_control.ct_state, flags_heard(self.builder))
        if not self.failsafe.armed:
            self._previous = self._limits.resting(self.builder.signal("average_steering_ang_fdbk"))
            return self._applied(now_ns, state, False, ())
        wanted = self._wanted(now_ns, state)
        command, limited = self._limits.apply(wanted, self._previous)
        sent = False
        if self._transmits:
            self._previous, sent = self._transmitter.actuators(command, self._previous)
        else:  # shadow: as if it had left
            self._previous = command
        self._sent += sent
        self._limited += bool(limited)
        self._note_latency(now_ns)
        return self._applied(now_ns, state, sent, limited)

    def _wanted(self, now_ns: int, state: VehicleState) -> Actuators:
        gear = self._gears.step(now_ns, rear_speed(state))
        command = self._gate.newest
        driving = self.failsafe.action is FailsafeAction.DRIVE
        if driving and self._testing:
            return actuator_test.position((now_ns - self._armed_ns) / NS_PER_S)
        if driving and command is not None:
            steer, drive = command.steer, command.drive
        else:
            emergency = self.failsafe.action is FailsafeAction.EMERGENCY_STOP
            steer, drive = self._stopping.command(state, self._dead_reckoning.pose, emergency)
        wanted = self._actuation.to_actuators(steer, drive, state.gear or gear, state.engine_speed, gear)
        if driving or road_speed(state) >= STANDSTILL or not state.valid:
            return wanted
        hold = self._config.gateway.stop.hold_pressure
        return Actuators(wanted.steering_motor, 0.0, hold, hold, gear)

    def _note_latency(self, now_ns: int) -> None:
        """CAN report in to the first command frame that answers it."""
        command = self._gate.newest
        driving = self.failsafe.action is FailsafeAction.DRIVE
        if driving and command is not None and command.seq != self._answered_seq:
            self._answered_seq = command.seq
            self._latency_ms.add((now_ns - command.state_stamp_ns) / 1e6)

    def _applied(self, now_ns: int, state: VehicleState, sent: bool, limited: tuple[str, ...]) -> Applied:
        actuators = self._limits.to_actuators(self._previous)
        return Applied(
            stamp_ns=now_ns,
            seq=self._seq,
            sent=sent,
            action=self.failsafe.action,
            limited=limited,
            steer=self._actuation.to_steer(actuators.steering_motor),
            drive=self._actuation.to_drive(actuators, state.engine_speed, state.gear),
            accelerator_percent=100 * actuators.accelerator,
            brake_front_kpa=actuators.brake_front / 1e3,
            brake_rear_kpa=actuators.brake_rear / 1e3,
            steering_motor_deg=actuators.steering_motor * 57.29577951308232,
            gear=actuators.gear,
        )

    def _status(self, now_ns: int, inputs: Inputs) -> GatewayStatus:
        counts, link = self.builder.counts, self._link.stats()
        return GatewayStatus(
            stamp_ns=now_ns,
            seq=self._status_seq,
            mode=self._config.gateway.mode,
            armed=self.failsafe.armed,
            action=self.failsafe.action,
            cause=self.failsafe.cause or (self._killed_by if self.race_control.ct_state is CtState.EMERGENCY else ""),
            missing_for_arming=() if self.failsafe.armed else missing_for_arming(inputs),
            bus=self._link.kind,
            bus_state=str(link.bus_state),
            frames_received=counts.received,
            frames_lost=counts.lost + link.lost,
            frames_unknown=counts.unknown,
            frames_malformed=counts.malformed + link.malformed,
            counter_errors=counts.counter_errors,
            commands_sent=self._sent,
            commands_limited=self._limited,
            loop_latency_p50_ms=self._latency_ms.quantile(0.5),
            loop_latency_p99_ms=self._latency_ms.quantile(0.99),
            detail=self._detail,
        )


def strongest(requests: list[OperatorAction]) -> OperatorAction | None:
    """The request that counts when several arrived in one period."""
    order = (OperatorAction.EMERGENCY, OperatorAction.STOP, OperatorAction.DISARM, OperatorAction.ARM)
    return next((action for action in order if action in requests), None)
