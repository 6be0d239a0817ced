"""What the base station of the simulated car is asked to show, and what it shows; a real car has race control's own."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from hil_gateway.bus.messages import Message, Name
from hil_gateway.car.states import TrackFlag, VehicleFlag

MOST_SPEED = 100.0
"""m/s that the base station may name: 224 mph, more than any car of the series drives"""
TargetSpeed = Annotated[float, Field(ge=0, le=MOST_SPEED)]


class RaceControlRequest(Message):
    """A change of what the base station shows; null leaves as it is."""

    source: Name
    track_flag: TrackFlag | None = None
    vehicle_flag: VehicleFlag | None = None
    target_speed: TargetSpeed | None = Field(default=None, description="m/s under yellow; 0: none named")
    beating: bool | None = Field(default=None, description="whether its heartbeat advances")


class RaceControlShown(Message):
    """What the simulated base station shows now (5 Hz)."""

    track_flag: TrackFlag
    vehicle_flag: VehicleFlag
    target_speed: TargetSpeed
    beating: bool

    def shows(self, request: RaceControlRequest) -> bool:
        """Whether all that was asked for is shown."""
        asked = request.model_dump(include={"track_flag", "vehicle_flag", "target_speed", "beating"}, exclude_none=True)
        return all(getattr(self, name) == value for name, value in asked.items())
