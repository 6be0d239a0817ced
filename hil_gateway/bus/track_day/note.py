"""What a person says of the car, into the recording."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from hil_gateway.bus.messages import Message, Name, Text

Temperature = Annotated[float, Field(ge=-50.0, le=100.0, allow_inf_nan=False)]


class Note(Message):
    """A remark with its time, and the tyre set that is on from then on."""

    source: Name
    text: Text = ""
    tyres: Name = Field(default="", description="name of the tyre set; empty: as before")
    air_c: Temperature | None = Field(default=None, description="of the air, deg C; null: as before")
    road_c: Temperature | None = Field(default=None, description="of the road, deg C; null: as before")
