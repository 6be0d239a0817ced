"""What tyres and brakes deliver now of the force expected of them; part of the estimate."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from hil_gateway.process.model import Model

Share = Annotated[float, Field(ge=-1e4, le=1e4)]


class Delivered(Model):
    """Force of the last 0.1 s over what the estimator's model gives for the same motion; null: too little to tell."""

    front: Share | None = Field(description="across the front axle")
    rear: Share | None
    brakes: Share | None = Field(description="of both axles while braking, wheels rolling")
    locking: tuple[bool, bool] = Field(
        default=(False, False), description="wheels of front and rear axle slip beyond their tyres' peak"
    )
