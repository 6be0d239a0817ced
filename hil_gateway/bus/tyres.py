"""What the car reports of its tyres."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from hil_gateway.bus.messages import Message, Pressure

Temperature = Annotated[float, Field(ge=-300, le=10_000)]


class Tyres(Message):
    """Temperature and pressure of the four tyres as reported (5 Hz)."""

    temperature: tuple[Temperature | None, ...] = Field(
        min_length=4, max_length=4, description="mean over the width of the tread, degC; fl, fr, rl, rr"
    )
    hottest: tuple[Temperature | None, ...] = Field(min_length=4, max_length=4, description="hottest point, degC")
    pressure: tuple[Pressure | None, ...] = Field(min_length=4, max_length=4, description="over the air outside, Pa")
