"""The line the planner aims at and the speed it asks for on it: for people, nothing acts on it."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from hil_gateway.bus.messages import Message, Motion, Position

Points = Field(max_length=1000)


class RaceLine(Message):
    """Closed line at equal steps, the first point not repeated; arrays of one length."""

    x: Annotated[tuple[Position, ...], Points]
    y: Annotated[tuple[Position, ...], Points]
    vx: Annotated[tuple[Motion, ...], Points] = Field(description="speed asked for, m/s")
    track_s: Annotated[tuple[Position, ...], Points] = Field(description="position of each point on the track, m")
    clearance_m: float = Field(ge=0, le=100, description="least distance of the car's centre from the track's edges")
    lap_time_s: float = Field(ge=0, le=1e6, description="of this line at this speed")

    @model_validator(mode="after")
    def _one_length(self) -> Self:
        if len({len(row) for row in (self.x, self.y, self.vx, self.track_s)}) > 1:
            raise ValueError("the arrays of a line are of different length")
        return self
