"""The car in time: actuator delays, gear shifts, road under it, and one Runge-Kutta step a millisecond."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

from hil_gateway.compiled import compile_function
from hil_gateway.plant.dynamics import INPUTS, OUTPUTS, STATES, step_function
from hil_gateway.plant.parameters import PlantParameters
from hil_gateway.plant.road import Road
from hil_gateway.track import Track

STEP_S = 1e-3
ROAD_STEPS = 5
"""the road is looked up every so many steps: 0.4 m at 80 m/s"""
STATE = {name: i for i, name in enumerate(STATES)}
OUTPUT = {name: i for i, name in enumerate(OUTPUTS)}


@dataclass(frozen=True, slots=True)
class Commands:
    """What the actuators are asked for: rad at the road wheel, 0..1, Pa, gear (0 neutral)."""

    steer: float = 0.0
    throttle: float = 0.0
    brake_front: float = 0.0
    brake_rear: float = 0.0
    gear: int = 0


class DelayLine:
    """The value of `steps` calls ago; before that, the first one."""

    def __init__(self, steps: int) -> None:
        self._line: deque[Any] = deque(maxlen=steps + 1)

    def __call__(self, value: Any) -> Any:
        self._line.append(value)
        return self._line[0]


class Car:
    """State of the simulated car. `step` advances it by `STEP_S`."""

    def __init__(self, parameters: PlantParameters, track: Track, start_s: float = 0.0, speed: float = 0.0) -> None:
        self.parameters = parameters
        self.road = Road(track, parameters.road)
        self._function = compile_function(step_function())
        self._x, self._u, p, h = (a[:, 0] for a in self._function.inputs)
        self._after, self.outputs = (a[:, 0] for a in self._function.outputs)
        p[:] = parameters.car.vector()
        h[0] = STEP_S
        self._steer_line = DelayLine(round(parameters.steer_delay / STEP_S))
        self._brake_line = DelayLine(round(parameters.brake_delay / STEP_S))
        self._throttle_line = DelayLine(round(parameters.throttle_delay / STEP_S))
        self._late_steer = DelayLine(round(parameters.steer_late / STEP_S))
        self._late_drive = DelayLine(round(parameters.drive_late / STEP_S))
        self.gear = 0
        self.shifting = 0
        self.steps = 0
        self.steer_rate = 0.0
        self._gravity = (0.0, 0.0, 9.8)
        self.place(start_s, speed)

    def place(self, s: float, speed: float = 0.0) -> None:
        """Put the car on the centre line at arc length `s`, rolling at `speed` (m/s)."""
        point = self.road.track.at(s)
        self._x[:] = 0.0
        self._x[:4] = point.x, point.y, point.heading, speed
        self._x[STATE["spin_fl"] : STATE["spin_fl"] + 4] = speed / self.parameters.car.wheel_radius
        self.road.s = s
        self.step(Commands(), engine_running=True)

    def __getitem__(self, name: str) -> float:
        """A state by name (`dynamics.STATES`), SI."""
        return float(self._x[STATE[name]])

    def output(self, name: str) -> float:
        """An output by name (`dynamics.OUTPUTS`), SI, at the start of the last step."""
        return float(self.outputs[OUTPUT[name]])

    @property
    def state(self) -> Any:
        """View of the state vector, shape (len(STATES),)."""
        return self._x

    @property
    def time_s(self) -> float:
        """Since the car was made."""
        return self.steps * STEP_S

    @property
    def standing(self) -> bool:
        """Whether the car stands still."""
        return abs(float(self._x[3])) < 0.1

    def step(self, commands: Commands, engine_running: bool) -> None:
        """Advance by one millisecond under the commands as they arrive at the actuators."""
        x = self._x
        yaw, vx, yaw_rate = x[2], x[3], x[5]
        if self.steps % ROAD_STEPS == 0:
            self.road.locate(float(x[0]), float(x[1]))
            self._gravity = self.road.gravity(float(yaw), float(vx), float(yaw_rate))
        grip = max(0.1, 1.0 + self.parameters.road.grip_drift * self.time_s)
        brakes = self._brake_line((commands.brake_front, commands.brake_rear))
        late = self._late_drive((x[21], x[22], x[23]))
        self._u[:] = (
            self._steer_line(commands.steer),
            self._throttle_line(commands.throttle),
            *brakes,
            self._ratio(commands.gear),
            float(engine_running),
            *self._gravity,
            grip,
            self._late_steer(x[20]),
            *late,
        )
        self._function()
        self.steer_rate = float(self._after[20] - x[20]) / STEP_S
        x[:] = self._after
        self.steps += 1

    def _ratio(self, wanted: int) -> float:
        """Engine over axle speed; 0 in neutral and while a shift is under way."""
        p = self.parameters
        if wanted != self.gear and 0 <= wanted <= len(p.gears):
            self.shifting = round(p.shift_time / STEP_S) if self.gear and wanted else 0
            self.gear = wanted
        if self.shifting:
            self.shifting -= 1
            return 0.0
        return p.gears[self.gear - 1] * p.final_drive if self.gear else 0.0


assert len(INPUTS) == 14  # the order in which `step` writes them
