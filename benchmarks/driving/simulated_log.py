"""Drive logs from the simulated car: known truth for campaigns and tests of identification and diagnosis."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from benchmarks.driving.laps import drive
from estimator.drive_log.table import DriveLog, segment_numbers
from hil_gateway.track.track import Track


def simulate(
    effects: Mapping[str, float] | None = None,
    laps: int = 8,
    seed: int = 1,
    track: Track | str | None = None,
    base: Literal["paper", "av24"] = "paper",
) -> DriveLog:
    """Progressively faster laps of the simulated car with realistic sensor noise, 100 Hz.

    `base` "paper" has nothing but the effects named (Eq. 1-3 underneath); "av24" has them all at realistic sizes.
    Sizes are those of `hil_gateway.plant.physics.effects.SWITCHES`. One seed gives one log.

    Raises:
        InputError: unknown effect, size out of range, broken track.
    """
    columns = drive(effects, base=base, laps=laps, seed=seed, track=track).columns
    named = ", ".join(f"{name}={size:g}" for name, size in (effects or {}).items()) or "no effect"
    return DriveLog(
        columns=columns,
        segment=segment_numbers(columns["t"]),
        notes=(f"simulated: {base}, {named}, seed {seed}",),
    )
