"""Sessions of a season as the index of a day keeps them, drawn at random: what a season is judged on."""

from __future__ import annotations

from typing import Any

import numpy as np

NAMES = ("grip, front", "stiffness, rear", "friction, rear", "longitudinal stiffness")
BEGAN_S = 1_790_000_000.0
A_DAY = 8
"""sessions"""


def sessions(seed: int, count: int, resemblance: float) -> list[dict[str, Any]]:
    """Nothing changes; every quantity resembles itself from session to session by this correlation."""
    rng = np.random.default_rng([seed, count])

    def walk(mean: float, std: float) -> np.ndarray:
        noise = rng.normal(0.0, std * np.sqrt(1.0 - resemblance**2), count)
        values = [rng.normal(0.0, std)]
        for step in noise[1:]:
            values.append(resemblance * values[-1] + step)
        return mean + np.array(values)

    tyres = [walk(1.6, 0.03) for _ in NAMES]
    drag, brakes, lap, loop = walk(0.6, 0.02), walk(1.0, 0.03), walk(96.0, 0.4), walk(22.0, 2.0)
    return [
        {
            "number": n + 1, "file": f"day{n // A_DAY:02d}/session_{n % A_DAY}.mcap", "car": "av24",
            "start_unix_s": BEGAN_S + 86400.0 * (n // A_DAY) + 2400.0 * (n % A_DAY), "track": "road_course",
            "software": "1.0", "best_lap_s": float(lap[n]), "loop_ms": float(loop[n]), "remarks": [], "weather": {},
            "tyres": {"A1": {"laps": 3, "km": 9.0}}, "alerts": [{}] * rng.poisson(0.5),
            "stops": [{}] * rng.poisson(0.2),
            "tyres_believed": [
                {"name": name, "unit": "", "mean": float(values[n]), "std": 0.03}
                for name, values in zip(NAMES, tyres, strict=True)
            ],
            "revisions": [
                {"parameters": {"aero_drag": {"c": float(drag[n])}, "front_brake": {"gain": float(brakes[n])}}}
            ],
        }
        for n in range(count)
    ]  # fmt: skip
