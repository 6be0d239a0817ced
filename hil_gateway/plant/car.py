"""The car in time: actuator delays, gear shifts, road under it, and one Runge-Kutta step a millisecond."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from struct import Struct
from typing import Any, NamedTuple

from hil_gateway.plant.events import CALM, Disturbance, Event, disturbance, pushed
from hil_gateway.plant.physics.dynamics import INPUTS, OUTPUTS, STATES, step_function
from hil_gateway.plant.physics.parameters import PlantParameters
from hil_gateway.plant.physics.road import Road
from hil_gateway.process.compiled import compile_function
from hil_gateway.track.track import Track

STEP_S = 1e-3
ROAD_STEPS = 5
"""the road is looked up every so many steps: 0.4 m at 80 m/s"""
MOVING = 0.5
"""m/s; a standing car sways on its tyres below it"""
STATE = {name: i for i, name in enumerate(STATES)}
OUTPUT = {name: i for i, name in enumerate(OUTPUTS)}
STEER = STATE["steer"]
VELOCITY = slice(STATE["vx"], STATE["vy"] + 1)
TYRE_USE = slice(OUTPUT["use_front"], OUTPUT["slip_rear"] + 1)
BRAKES = slice(2, 4)
"""of `Commands`"""
SURROUNDINGS = INPUTS.index("gravity_x")
"""the inputs from there on are those of the place"""
PACK_STEP, PACK_SURROUNDINGS = Struct(f"{SURROUNDINGS}d"), Struct(f"{len(INPUTS) - SURROUNDINGS}d")


class Commands(NamedTuple):
    """What the actuators are asked for: rad at the road wheel, 0..1, Pa, gear (0 neutral)."""

    steer: float = 0.0
    throttle: float = 0.0
    brake_front: float = 0.0
    brake_rear: float = 0.0
    gear: int = 0


def delay_line(delay_s: float) -> deque[Any]:
    """What is appended in every step comes to its front so much later; before that, the first one is there."""
    return deque(maxlen=round(delay_s / STEP_S) + 1)


class LateActuators:
    """Actuator positions as they were: steering, throttle and both brakes, each after its own extra delay."""

    def __init__(self, parameters: PlantParameters) -> None:
        self._steer, self._drive = delay_line(parameters.steer_late), delay_line(parameters.drive_late)
        self.delayed = parameters.steer_late > 0 or parameters.drive_late > 0

    def __call__(self, steer: float, *drive: float) -> Sequence[float]:
        self._steer.append(steer)
        self._drive.append(drive)
        return self._steer[0], *self._drive[0]


class Car:
    """State of the simulated car. `step` advances it by `STEP_S`."""

    def __init__(
        self, parameters: PlantParameters, track: Track, start_s: float = 0.0, speed: float = 0.0,
        events: Sequence[Event] = (),
    ) -> None:  # fmt: skip
        self.parameters = parameters
        self._events, self._disturbed, self._moved_s = events, CALM, float("inf")
        self.road = Road(track, parameters.road)
        self._function = compile_function(step_function())
        self._x, u, p, h = (a[:, 0] for a in self._function.inputs)
        after, outputs = (a[:, 0] for a in self._function.outputs)
        self._advance = self._function.evaluate
        # single numbers are read and written through memory views: several times quicker than array elements
        self._state, self._after, self._outputs, self._u = self._x.data, after.data, outputs.data, u.data
        p[:] = parameters.car.vector()
        h[0] = STEP_S
        self._steer_line, self._brake_line = delay_line(parameters.steer_delay), delay_line(parameters.brake_delay)
        self._throttle_line = delay_line(parameters.throttle_delay)
        self._late = LateActuators(parameters)
        self._ratios = 0.0, *(gear * parameters.final_drive for gear in parameters.gears)
        self.gear = 0
        self.shifting = 0
        self.steps = 0
        self.steer_rate = 0.0
        self.place(start_s, speed)

    def place(self, s: float, speed: float = 0.0, lateral: float = 0.0, turned: float = 0.0) -> None:
        """Put the car at arc length `s`, `lateral` m to the left of the centre line and turned by so much (rad) to the
        left of the track, rolling at `speed` (m/s)."""
        point = self.road.track.at(s)
        x, y = point.x - lateral * math.sin(point.heading), point.y + lateral * math.cos(point.heading)
        self._x[:] = 0.0
        self._x[:4] = x, y, point.heading + turned, speed
        self._x[STATE["spin_fl"] : STATE["spin_fl"] + 4] = speed / self.parameters.car.wheel_radius
        self.road.s = s
        self.step(Commands(), engine_running=True)

    def __getitem__(self, name: str) -> float:
        """A state by name (`dynamics.STATES`), SI."""
        return self._state[STATE[name]]

    def output(self, name: str) -> float:
        """An output by name (`dynamics.OUTPUTS`), SI, at the start of the last step."""
        return self._outputs[OUTPUT[name]]

    @property
    def velocity(self) -> Sequence[float]:
        """Along the car and to its left, m/s."""
        return self._state[VELOCITY]

    @property
    def tyre_use(self) -> Sequence[float]:
        """Force of front and rear axle over what they could give, and their slip over that of the peak, then."""
        return self._outputs[TYRE_USE]

    @property
    def time_s(self) -> float:
        """Since the car was made."""
        return self.steps * STEP_S

    @property
    def standing(self) -> bool:
        """Whether the car stands still."""
        return abs(self["vx"]) < 0.1

    @property
    def flats(self) -> tuple[float, ...]:
        """Per wheel (fl, fr, rl, rr) 0 (sound) to 1 (without air)."""
        return self._disturbed.flats

    @property
    def uncorrected(self) -> bool:
        """Whether receivers get no corrections now."""
        return self._disturbed.uncorrected

    def happens(self, event: Event) -> None:
        """One more event, beside those the car was made with."""
        self._events = (*self._events, event)

    def step(self, commands: Commands, engine_running: bool) -> None:
        """Advance by one millisecond under the commands as they arrive at the actuators."""
        state = self._state
        if self.steps % ROAD_STEPS == 0:
            self._look_around()
        steer, throttle, brakes = self._steer_line, self._throttle_line, self._brake_line
        steer.append(commands.steer)
        throttle.append(commands.throttle)
        brakes.append(commands[BRAKES])
        actuators = state[STEER : STEER + 4]
        PACK_STEP.pack_into(
            self._u, 0, steer[0], throttle[0], *brakes[0], self._ratio(commands.gear), engine_running,
            *(self._late(*actuators) if self._late.delayed else actuators),
        )  # fmt: skip
        self._advance()
        self.steer_rate = (self._after[STEER] - state[STEER]) / STEP_S
        state[:] = self._after
        self.steps += 1

    def _look_around(self) -> None:
        """What acts on the car where it is now."""
        x, y, yaw, vx, _, yaw_rate = self._state[:6]
        self.road.locate(x, y)
        disturbed = self._disturbed = self._disturbance(vx)
        drift = max(0.1, 1.0 + self.parameters.road.grip_drift * self.time_s)
        PACK_SURROUNDINGS.pack_into(
            self._u,
            PACK_STEP.size,
            *self.road.gravity(yaw, vx, yaw_rate),
            drift * disturbed.grip,
            *disturbed.flats,
            disturbed.gust,
            disturbed.brake_loss,
            disturbed.push,
        )

    def _disturbance(self, vx: float) -> Disturbance:
        """Events count from when the car first moves, but for those that move it."""
        if self._moved_s > self.time_s and vx > MOVING:
            self._moved_s = self.time_s
        since = self.time_s - self._moved_s
        driving = disturbance(self._events, since, self.road.s, self.road.track.length) if since >= 0.0 else CALM
        return pushed(self._events, self.time_s, vx, driving)

    def _ratio(self, wanted: int) -> float:
        """Engine over axle speed; 0 in neutral and while a shift is under way."""
        if wanted != self.gear and 0 <= wanted < len(self._ratios):
            self.shifting = round(self.parameters.shift_time / STEP_S) if self.gear and wanted else 0
            self.gear = wanted
        if self.shifting:
            self.shifting -= 1
            return 0.0
        return self._ratios[self.gear]
