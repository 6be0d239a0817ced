"""From the decision to this period's frames: what is wanted, what the limits leave of it, what left."""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

from can_dbc.codec import Codec
from hil_gateway.bus.messages import Applied, Command, FailsafeAction, VehicleState
from hil_gateway.can_link import CanLink
from hil_gateway.car.actuation import Actuation, ActuatorPositions
from hil_gateway.car.powertrain import GearChoice
from hil_gateway.car.states import CtState
from hil_gateway.config import Config
from hil_gateway.gateway.act import actuator_test
from hil_gateway.gateway.act.axle_brakes import AxleBrakes, AxleDemand
from hil_gateway.gateway.act.hill_start import HillStart
from hil_gateway.gateway.act.limits import Limits, RawCommand
from hil_gateway.gateway.act.stopping import Stopping
from hil_gateway.gateway.act.stuck_steering import StuckSteering
from hil_gateway.gateway.act.transmitter import Transmitter
from hil_gateway.gateway.decide.decision import Decision
from hil_gateway.gateway.decide.ladder_inputs import Flags
from hil_gateway.gateway.perceive.dead_reckoning import Pose
from hil_gateway.gateway.perceive.motion import Motion
from hil_gateway.gateway.perceive.road_speed import STANDSTILL, road_speed
from hil_gateway.observer.axles import Axles
from hil_gateway.observer.steering import SteeringHypotheses
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.settings.gateway import CAUTION_DECELERATION
from hil_gateway.track.track import Track

CAUTION_S = 2.0
"""time constant with which the car approaches the caution speed"""

HARD = ("tyre_flat", "position_wrong", "position_lost")
"""causes for which a controlled stop brakes as an emergency does: with less grip every bend ahead is too fast, and the
longer a car goes without fixes, the further it is from where it takes itself to be"""
UNBRAKED = ("pedals_stuck", "commands_unanswered")
"""causes for which the brakes, or some of them, may not work"""


class Period(NamedTuple):
    """What the actuators of one period go by."""

    now_ns: int
    state: VehicleState
    motion: Motion
    decision: Decision
    command: Command | None
    pose: Pose | None
    flat_front: bool
    flat_rear: bool
    """whether a tyre of that axle is flat"""
    blind: bool
    """whether no fixes hold the pose"""
    turns: SteeringHypotheses
    """by which angle the car does"""
    steering_stands: bool
    """whether its report does not move as it is asked to"""
    steering_reversed: bool
    """whether the steering goes to the other side than its command: a stop then asks for the other side"""
    caution_speed: float
    """m/s, under yellow flags"""
    axles: Axles | None = None
    """when what is asked for now is answered; in a stop"""


class Actor:
    """Actuators of the car: holds what stands on the wire and the path to stop on."""

    def __init__(self, config: Config, codec: Codec, link: CanLink, actuation: Actuation, track: Track | None) -> None:
        self._actuation, car = actuation, config.declared_car
        self._full_steering = car.actuators.steering_range * car.vehicle.steering_ratio
        self._hold_pressure = car.hold_pressure
        forward = 2.0 * car.std(f"imu.{next(iter(car.imus))}.acceleration_offset")  # as hardly any accelerometer is off
        self._hill = HillStart(self._hold_pressure, forward) if config.gateway.hold else None
        self._testing = config.gateway.mode == "actuator_test"
        self._transmits = config.gateway.mode in ("armed", "actuator_test")
        self._mass_per_force = config.vehicle.mass / config.powertrain.force_per_drive
        self._full_brakes = config.powertrain.hardest_braking / config.powertrain.force_per_drive
        """slip-ratio drive command"""
        self._drag_force = partial(config.powertrain.drag_force, wheel_radius=config.vehicle.wheel_radius)
        self._gears = GearChoice(config.powertrain, config.vehicle.wheel_radius)
        self._limits = Limits(config.car, config.gateway.limits.within(config.car))
        self._transmitter = Transmitter(codec, link, config.gateway.vehicle_number)
        self._stand(self._limits.resting(0.0))
        self.stopping = Stopping(car, config.gateway.stop, track)
        self._stuck = StuckSteering(car, config.gateway.stop, track)
        self._axles = AxleBrakes(car, config.gateway.stop.lateral_grip)
        self._holding = False
        """whether the brakes hold the standing car, whatever a command asks for"""
        self._commands = False
        """whether the car was commanded in the period before"""
        self.sent = self.limited = 0

    @property
    def transmits(self) -> bool:
        """Whether the mode sends frames."""
        return self._transmits

    def _stand(self, command: RawCommand) -> None:
        """Keep the last commands that left, as integers and in SI."""
        self._on_wire, self.on_wire = command, self._limits.to_actuators(command)

    def report_ladder(self, now_ns: int, ct_state: CtState, flags: Flags) -> None:
        """State and acknowledged flags, when they are due."""
        if self._transmits:
            self._transmitter.race_control(now_ns, ct_state, flags)

    def start_stop(self) -> None:
        """A stop begins: the angle on the wire is where steering goes on from."""
        self.stopping.start(self._actuation.to_steer(self.on_wire.steering_motor))
        self._stuck.start()
        self._axles.start()

    def step(self, now: Period) -> tuple[bool, tuple[str, ...]]:
        """Send this period's commands; whether all left, and the limits that changed them."""
        self.stopping.flat, self.stopping.blind = now.flat_front or now.flat_rear, now.blind
        armed, self._holding = now.decision.failsafe.armed, now.decision.holding
        if self._hill is not None:
            self._hill.watch(now.state, self.on_wire)
        if not self._commands:  # they begin where the steering is
            self._stand(self._limits.resting(self._actuation.to_steering_motor(now.state.steer)))
        self._commands = armed or self._holding
        if not self._commands:
            return False, ()
        still = self.on_wire.steering_motor, self.on_wire.gear
        wanted = self._wanted(now) if armed else self._parked(*still)
        stands, limited = self._limits.apply(wanted, self._on_wire)
        sent = False
        if self._transmits:  # in shadow as if it had left
            stands, sent = self._transmitter.actuators(stands, self._on_wire)
        self._stand(stands)
        self.sent += sent
        self.limited += bool(limited)
        return sent, limited

    def _parked(self, steering_motor: float, gear: int) -> ActuatorPositions:
        """Brakes alone."""
        self._holding = True
        return ActuatorPositions(steering_motor, 0.0, self._hold_pressure, self._hold_pressure, gear)

    def _wanted(self, now: Period) -> ActuatorPositions:
        state, motion, command = now.state, now.motion, now.command
        gear = self._gears.step(now.now_ns, motion.speed, state.engine_speed, state.gear)
        self._axles.watch(state, self.on_wire)
        driving = now.decision.action is FailsafeAction.DRIVE
        if driving and self._testing:
            return actuator_test.position((now.now_ns - now.decision.silent_ns) / NS_PER_S, self._full_steering)
        balance = None  # a stop brakes as declared, whatever the planner asked for before
        if driving and command is not None:
            steer, drive, balance = command.steer, self._paced(command.drive, now), command.brake_balance
            if self._hill is not None and self._hill.holds(state, drive / self._mass_per_force):
                return self._parked(self._actuation.to_steering_motor(steer), gear)
        else:
            steer, drive = self._stop(now)
        wanted = self._actuation.to_actuators(steer, drive, state.gear or gear, state.engine_speed, gear, balance)
        lateral = self.stopping.lateral
        if not driving and lateral is not None:
            demand = AxleDemand(lateral, now.flat_front, now.flat_rear, self._drag_force(state.gear))
            wanted = self._axles.step(wanted, demand, state, motion)
        if driving or road_speed(state) >= STANDSTILL or not state.valid:
            return wanted
        return self._parked(wanted.steering_motor, gear)

    def _stop(self, now: Period) -> tuple[float, float]:
        """Road-wheel angle (rad) and slip-ratio drive command of a stop."""
        cause, motion, pose = now.decision.failsafe.cause, now.motion, now.pose
        emergency = now.decision.action is FailsafeAction.EMERGENCY_STOP or cause in HARD
        stuck = cause == "steering_stuck" and not now.steering_reversed
        if stuck:
            self._stuck.judge(now.turns, still=now.steering_stands)
        held = stuck and self._stuck.stands
        brakes = cause not in UNBRAKED
        steer, drive = self.stopping.command(motion, pose, emergency, now.axles, steers=not held, brakes=brakes)
        if stuck and self._stuck.locks(motion, pose, now.state.steer):
            drive = -self._full_brakes
        return (-steer if now.steering_reversed else steer), drive

    def _paced(self, drive: float, now: Period) -> float:
        """Slip-ratio drive command of which no more is left, under yellow flags, than leads to the caution speed."""
        if now.decision.race_control.ct_state is not CtState.CAUTION:
            return drive
        wanted = max((now.caution_speed - now.motion.speed) / CAUTION_S, -CAUTION_DECELERATION)
        return min(drive, self._mass_per_force * wanted)

    def applied(  # noqa: PLR0917 - what a message says
        self, now_ns: int, seq: int, state: VehicleState, decision: Decision, sent: bool, limited: tuple[str, ...]
    ) -> Applied:  # fmt: skip
        """What stands on the wire, as a message."""
        actuators = self.on_wire
        return Applied(
            stamp_ns=now_ns,
            seq=seq,
            sent=sent,
            action=decision.action,
            limited=limited,
            steer=self._actuation.to_steer(actuators.steering_motor),
            drive=self._actuation.to_drive(actuators, state.engine_speed, state.gear),
            accelerator_percent=100 * actuators.accelerator,
            brake_front_kpa=actuators.brake_front / 1e3,
            brake_rear_kpa=actuators.brake_rear / 1e3,
            steering_motor_deg=math.degrees(actuators.steering_motor),
            gear=actuators.gear,
            holding=self._holding,
        )
