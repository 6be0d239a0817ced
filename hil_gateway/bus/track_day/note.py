"""What a person says of the car, into the recording."""

from __future__ import annotations

from pydantic import Field

from hil_gateway.bus.messages import Message, Name, Text


class Note(Message):
    """A remark with its time, and the tyre set that is on from then on."""

    source: Name
    text: Text = ""
    tyres: Name = Field(default="", description="name of the tyre set; empty: as before")
