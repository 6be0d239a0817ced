"""Log health: what is wrong with a recording, found from the recording itself before anything is fitted.

Finders are small modules with `find(log, vehicle)`; they run in an order in which each can rely on what the ones
before it repaired. Every repair can be switched off by the finding's name.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

from estimator.drive_log.table import DriveLog
from estimator.offline.health import (
    acceleration,
    lateral_velocity,
    offsets,
    sampling,
    speed,
    steering,
    units,
    wheels,
)
from estimator.offline.health.finding import Action, LogFinding
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.errors import InputError

__all__ = ["Action", "HealthReport", "LogFinding", "examine"]

FINDERS: tuple[Callable[[DriveLog, Vehicle], list[LogFinding]], ...] = (
    sampling.find,
    units.find,
    speed.find,
    offsets.find,
    acceleration.find,
    lateral_velocity.find,
    steering.find,
    wheels.find,
)


@dataclass(frozen=True)
class HealthReport:
    """What was found, and the log with what was repaired."""

    findings: tuple[LogFinding, ...]
    log: DriveLog

    @property
    def vy_is_displaced(self) -> bool:
        """Whether vy is not simply that of the CoG: a fit then estimates its sensor along with the tyres."""
        return any(f.channel == "vy" and f.action is Action.CORRECTED for f in self.findings)

    @property
    def vy_was_placed(self) -> bool:
        """Whether an accelerometer told where vy is measured: tyres that the model lacks parts of would move it."""
        return "ay" not in self.log.derived and any(f.name == lateral_velocity.POSITION_VY for f in self.findings)

    @property
    def vy_may_be_off(self) -> float:
        """m from the CoG at which vy may be measured without a fit that allows for it, as a standard deviation."""
        left = (f.std for f in self.findings if f.name == lateral_velocity.POSITION_VY and self.vy_was_placed)
        unknown = (f.size for f in self.findings if f.name == lateral_velocity.UNKNOWN_PLACE)
        return sum(left) if self.vy_is_displaced else sum(unknown)

    @property
    def yaw_rate_was_moved(self) -> bool:
        """Whether the yaw rate was re-aligned: a fit then estimates what is left of its lag."""
        return any(f.channel == "yaw_rate" and f.action is Action.REALIGNED for f in self.findings)

    @property
    def lateral_was_repaired(self) -> bool:
        """Whether a car's own logger recorded vy or the yaw rate."""
        return self.vy_is_displaced or self.yaw_rate_was_moved

    @property
    def steering_is_off(self) -> bool:
        """Whether the steering's zero is off: a fit then estimates it along with the tyres."""
        return any(f.name == steering.OFFSET_STEER and f.action is Action.CORRECTED for f in self.findings)

    def replaced(self, finding: LogFinding) -> HealthReport:
        """This report with `finding` instead of the one of its name."""
        return replace(self, findings=(*(f for f in self.findings if f.name != finding.name), finding))

    @property
    def doubtful(self) -> tuple[str, ...]:
        """Channels not to be explained by effects: repaired too coarsely for it, or found to be useless.

        Of vy and yaw rate neither tells the slip without the other, unless there is a lateral accelerometer: then what
        the repair of vy has left is estimated (`vy_is_displaced`).
        """
        useless = tuple(f.channel for f in self.findings if f.action is Action.EXCLUDED and f.repair is None)
        return ("vy", "yaw_rate") * (self.lateral_was_repaired and "ay" in self.log.derived) + useless

    def repaired(self, finding: LogFinding) -> HealthReport:
        """This report with one more finding and its repair, for what only a fit can find; sizes of one name add up."""
        log = self.log if finding.repair is None else _rederive(finding.repair(self.log), finding.channel)
        before = sum(f.size for f in self.findings if f.name == finding.name)
        total = replace(finding, size=before + finding.size, description=finding.described(before + finding.size))
        return replace(self.replaced(total), log=log)


def examine(log: DriveLog, vehicle: Vehicle, keep: Collection[str] = ()) -> HealthReport:
    """Run all finders on `log`; findings named in `keep` are reported but not acted on.

    Raises:
        InputError: a channel whose unit cannot be told.
    """
    findings: list[LogFinding] = []
    for finder in FINDERS:
        found = [_switched(finding, keep) for finding in finder(log, vehicle)]
        if refused := next((finding for finding in found if finding.action is Action.REFUSED), None):
            raise InputError(f"{', '.join(log.sources) or 'the log'}: {refused.description}")
        for finding in found:
            if finding.repair is not None:
                log = _rederive(finding.repair(log), finding.channel)
        findings += found
    return HealthReport(tuple(findings), log)


def _switched(finding: LogFinding, keep: Collection[str]) -> LogFinding:
    return replace(finding, action=Action.LEFT, repair=None) if finding.name in keep else finding


def _rederive(log: DriveLog, changed: str) -> DriveLog:
    """Accelerations that were derived follow what they were derived from."""
    axes = tuple(axis for axis in ("ax", "ay") if axis in log.derived)
    if changed not in ("vx", "vy", "yaw_rate") or not axes:
        return log
    return acceleration.rederived(log, axes, f"{', '.join(axes)} derived again after {changed} was repaired")
