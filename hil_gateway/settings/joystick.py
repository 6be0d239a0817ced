"""Settings of a person's joystick or wheel."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from hil_gateway.process.model import Model

Axis = Literal["x", "y", "z", "rx", "ry", "rz", "throttle", "rudder", "wheel", "gas", "brake"]


class JoystickConfig(Model):
    """Axes and buttons as the kernel numbers them (`hil joystick check` shows what moves), and what they ask for."""

    steer_axis: Axis = Field(default="x", description="grows to the right")
    drive_axis: Axis = Field(default="rz", description="accelerator, or the right trigger of a gamepad")
    brake_axis: Axis = Field(default="z", description="brake, or the left trigger")
    pedals_fall: bool = Field(default=False, description="their axes fall where they are pressed, as wheels have it")
    dead_man: int = Field(default=310, ge=0, lt=0x300, description="code of the button that is held while driving")
    steer_full: float = Field(default=0.15, gt=0, le=0.5, description="road-wheel angle at the stop of the axis, rad")
    drive_full: float = Field(default=0.02, gt=0, le=0.2, description="drive command of a pedal pressed down, slip")
    brake_full: float = Field(default=0.06, gt=0, le=0.2, description="the same of the brake")
