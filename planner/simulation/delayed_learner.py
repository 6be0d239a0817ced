"""The learner in the loop on virtual time: its child's work is done at once and told when it would have been done."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from estimator.learner.job import Failed
from estimator.learner.node import PERIOD_S, Learner
from hil_gateway.bus.interface import Bus
from hil_gateway.config import Config
from hil_gateway.process.errors import InputError
from hil_gateway.track.track import Track

DIAGNOSIS_S = 90.0
"""virtual time from the start of a diagnosis to its result: measured on two laps, one processor"""


class DelayedWork:
    """Work whose result is told after so many polls."""

    def __init__(self, work: Callable[[Any], Any], argument: Any, after_s: float = DIAGNOSIS_S) -> None:
        self._left = round(after_s / PERIOD_S)
        try:
            self._result = work(argument)
        except InputError as error:
            self._result = Failed(str(error))

    def poll(self) -> Any | None:
        """See `Running.poll`."""
        self._left -= 1
        return self._result if self._left <= 0 else None

    def stop(self) -> None:
        """See `Running.stop`."""


def learner(config: Config, bus: Bus, track: Track) -> Learner:
    """A component of the loop."""
    return Learner(config, bus, DelayedWork)
