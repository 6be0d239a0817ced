"""What happens to the simulated car during a run: a wet stretch, a gust, a puncture, brake fade, a crew that pushes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal, NamedTuple

from pydantic import Field

from hil_gateway.process.model import Model

WHEELS = ("fl", "fr", "rl", "rr")
Start = Annotated[float, Field(ge=0, description="s after the car first moved")]
Duration = Annotated[float, Field(gt=0, description="s")]


class GripEvent(Model):
    """A wet stretch: in time, or from `s` over `for_m` metres of the track on every lap."""

    kind: Literal["grip"]
    t: Start = 0.0
    for_s: Duration = float("inf")
    s: float | None = Field(default=None, ge=0, description="m")
    for_m: float = Field(default=0.0, ge=0, description="m")
    factor: float = Field(gt=0.05, le=1.5)


class GustEvent(Model):
    """A side force on the body, positive to its left."""

    kind: Literal["gust"]
    t: Start
    for_s: Duration
    force_n: float = Field(ge=-10_000, le=10_000)


class PunctureEvent(Model):
    """A tyre loses its air, and does not get it back."""

    kind: Literal["puncture"]
    t: Start
    wheel: Literal["fl", "fr", "rl", "rr"]


class BrakeFadeEvent(Model):
    """Both circuits' torque times `factor`."""

    kind: Literal["brake_fade"]
    t: Start
    for_s: Duration = float("inf")
    factor: float = Field(ge=0.1, le=1.0)


class PushEvent(Model):
    """A crew releases the brakes, pushes, and puts them on again."""

    kind: Literal["push"]
    t: float = Field(ge=0, description="s after the plant's start: the car need not have moved")
    for_s: Duration
    speed: float = Field(ge=-3, le=3, description="m/s, negative backwards")


class RtkEvent(Model):
    """Receivers with corrections go without: the radio of the base is out of reach, or a bridge hides satellites."""

    kind: Literal["rtk"]
    t: Start
    for_s: Duration


PUSH_MOST = 1200.0
"""N of a crew: three people who push with 400 N each; a grade of 9 % takes 690 N of an AV-24"""
PUSH_GAIN = 4000.0
"""N a m/s by which the car is slower than it is to be"""

Event = Annotated[
    GripEvent | GustEvent | PunctureEvent | BrakeFadeEvent | PushEvent | RtkEvent, Field(discriminator="kind")
]


class Disturbance(NamedTuple):
    """Factor on friction; per wheel 0 (sound) or 1 (flat); side force, N; share of the brakes' torque lost; force
    forward, N; receivers are without corrections."""

    grip: float = 1.0
    flats: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    gust: float = 0.0
    brake_loss: float = 0.0
    push: float = 0.0
    uncorrected: bool = False


CALM = Disturbance()


def disturbance(events: Sequence[Event], time_s: float, s: float, length: float) -> Disturbance:
    """What is under way `time_s` after the car first moved, at arc length `s` of a track of `length` m."""
    if not events:
        return CALM
    grip, gust, brakes, flat, uncorrected = 1.0, 0.0, 1.0, set(), False
    for event in events:
        if isinstance(event, PunctureEvent):
            flat |= {event.wheel} if time_s >= event.t else set()
        elif event.t <= time_s < event.t + event.for_s:
            if isinstance(event, GripEvent):
                grip *= event.factor if _there(event, s, length) else 1.0
            elif isinstance(event, GustEvent):
                gust += event.force_n
            elif isinstance(event, BrakeFadeEvent):
                brakes *= event.factor
            uncorrected = uncorrected or isinstance(event, RtkEvent)
    flats = tuple(float(wheel in flat) for wheel in WHEELS)
    return Disturbance(grip, flats, gust, 1.0 - brakes, uncorrected=uncorrected)


def pushed(events: Sequence[Event], time_s: float, vx: float, otherwise: Disturbance) -> Disturbance:
    """`otherwise`, with a crew at work where one is, `time_s` after the plant's start, at a speed of `vx` (m/s)."""
    for event in events:
        if isinstance(event, PushEvent) and event.t <= time_s < event.t + event.for_s:
            force = PUSH_GAIN * (event.speed - vx)
            return otherwise._replace(brake_loss=1.0, push=max(-PUSH_MOST, min(force, PUSH_MOST)))
    return otherwise


def _there(event: GripEvent, s: float, length: float) -> bool:
    return event.s is None or (s - event.s) % length < event.for_m
