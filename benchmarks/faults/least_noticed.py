"""The least error of each source that the gateway notices: ever larger ones on a drive, each in a forked copy.

    python -m benchmarks.faults.least_noticed SEED [TRACK]... > least.json

Random cars of the seed, from the places of its survey. An error counts as noticed when the car is being stopped within
`NOTICED_S`, whatever row says so.
"""

from __future__ import annotations

import json
import math
import sys
from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from benchmarks.campaign.run import with_bar
from benchmarks.faults.best_stop import in_a_copy
from benchmarks.faults.car_campaign import TRACKS, Run, running
from benchmarks.faults.car_faults import ANGLES, IMU, POSITION, STEERING, WHEELS, CarFault, north, plus, scaled
from benchmarks.faults.survey import draw
from hil_gateway.process.errors import InputError
from hil_gateway.track.loading import load_track

NOTICED_S = 4.0
"""after which an error counts as not noticed"""
STEP = 1.5
"""from one size to the next"""
SIZES = 12

Sized = Callable[[float], CarFault]


@dataclass(frozen=True)
class Error:
    """An error of one source, of any size."""

    source: str
    unit: str
    smallest: float
    of_size: Sized

    @property
    def sizes(self) -> list[float]:
        """Those that are tried, smallest first."""
        return [self.smallest * STEP**k for k in range(SIZES)]


@dataclass(frozen=True)
class Noticed:
    """The least size of an error that one place notices; None where none is."""

    source: str
    unit: str
    size: float | None
    after_s: float | None
    cause: str = ""


def _fault(name: str, messages: tuple[str, ...], **what: Any) -> CarFault:
    return CarFault(name, messages, (), NOTICED_S, "", **what)


def _offset(messages: tuple[str, ...], *names: str) -> Sized:
    return lambda size: _fault("offset", messages, alter=plus(size, *names))


def _share(messages: tuple[str, ...], *names: str) -> Sized:
    return lambda percent: _fault("scale", messages, alter=scaled(1.0 - 0.01 * percent, *names))


ERRORS = (
    Error("yaw rate off by", "rad/s", 0.005, _offset(IMU, "imu_yaw_rate")),
    Error("lateral acceleration off by", "m/s2", 0.2, _offset(IMU, "imu_ay")),
    Error("longitudinal acceleration off by", "m/s2", 0.2, _offset(IMU, "imu_ax")),
    Error("yaw rate too small by", "%", 1.0, _share(IMU, "imu_yaw_rate")),
    Error("a front wheel too slow by", "%", 0.5, _share(WHEELS, "wheel_speed_FR")),
    Error("a rear wheel too slow by", "%", 0.5, _share(WHEELS, "wheel_speed_RL")),
    Error("all wheels too slow by", "%", 0.5, _share(WHEELS, *(f"wheel_speed_{w}" for w in ("FL", "FR", "RL", "RR")))),
    Error(
        "steering angle reported off by", "deg at the motor", 1.0,
        lambda deg: _fault("offset", STEERING, alter=plus(math.radians(deg), *ANGLES)),
    ),
    Error("position off at once by", "m", 0.1, lambda m: _fault("step", POSITION, alter=north(lambda _: m))),
    Error("position drifts by", "m/s", 0.1, lambda v: _fault("drift", POSITION, alter=north(lambda m: v * m.t))),
    Error("position late by", "s", 0.01, lambda s: _fault("late", POSITION, delay_s=s)),
)  # fmt: skip


def least_noticed(run: Run, error: Error) -> Noticed:
    """By bisection: what is noticed is noticed when it is larger."""
    found: dict[int, tuple[float | None, str]] = {}

    def noticed(k: int) -> bool:
        found[k] = in_a_copy(partial(run.noticed, error.of_size(error.sizes[k]), NOTICED_S))
        return found[k][0] is not None

    k = bisect_left(range(SIZES), True, key=noticed)
    if k == SIZES:
        return Noticed(error.source, error.unit, None, None)
    return Noticed(error.source, error.unit, error.sizes[k], *found[k])


def results(seed: int, tracks: Sequence[str]) -> Iterator[Noticed]:
    """Every error from every place of the survey."""
    for number, track in enumerate(tracks):
        survey = draw(seed, number, track)
        times_s = [at_s for at_s, _ in survey.places]
        for run in running(track, survey.simulated, times_s, learn=survey.car % 2 == 1):
            if run.loop.result.failsafes:
                break
            yield from (least_noticed(run, error) for error in ERRORS)


def main(arguments: Sequence[str]) -> None:
    """The report goes to standard output, the bar to standard error."""
    if not arguments or not arguments[0].isdecimal():
        raise InputError("usage: python -m benchmarks.faults.least_noticed SEED [TRACK]..., SEED at least 0")
    seed, tracks = int(arguments[0]), arguments[1:] or TRACKS
    for track in tracks:
        load_track(track)
    total = len(tracks) * len(draw(seed, 0, tracks[0]).places) * len(ERRORS)
    print(json.dumps([asdict(r) for r in with_bar(results(seed, tracks), total, lambda r: r.source, forks=True)]))


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except InputError as error:
        raise SystemExit(f"least_noticed: {error}") from None
