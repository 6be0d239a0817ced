"""What log health finds: a defect with its size, how sure it is, and what is done about it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from estimator.drive_log.table import DriveLog

LEAST_ERRORS = 3.0
"""Standard errors by which something must be off to be there: 99.7 % of a normal distribution."""


class Action(StrEnum):
    """What is done about a finding."""

    REALIGNED = "re-aligned"
    CONVERTED = "converted"
    CORRECTED = "corrected"
    EXCLUDED = "excluded"
    LEFT = "left"
    REFUSED = "refused"
    """nothing is computed from such a log until a person says what it is"""


@dataclass(frozen=True)
class LogFinding:
    """One defect.

    `name` switches it (`--keep NAME`); `size` in `unit` with `std`; `confidence` 0..1; `repair` returns the log
    without the defect, None where nothing is done; `template` words the description for another size.
    """

    name: str
    channel: str
    description: str
    size: float
    std: float
    unit: str
    confidence: float
    action: Action = Action.LEFT
    repair: Callable[[DriveLog], DriveLog] | None = None
    template: Callable[[float], str] | None = None

    def described(self, size: float) -> str:
        """The description with another size."""
        return self.description if self.template is None else self.template(size)

    def summary(self) -> dict[str, Any]:
        """The finding as it appears in JSON."""
        return {
            "name": self.name,
            "channel": self.channel,
            "description": self.description,
            "size": self.size,
            "std": self.std,
            "unit": self.unit,
            "confidence": self.confidence,
            "action": str(self.action),
        }


def confidence_of(size: float, std: float, least: float) -> float:
    """Probability that the true size, normal about `size`, exceeds `least` in magnitude."""
    from math import erf, sqrt

    return 0.5 * (1.0 + erf((abs(size) - least) / (max(std, 1e-12) * sqrt(2.0))))
