"""What is not known of the brakes, as a factor on what their forces count beside tyres of unknown grip (Eq. 10).

A share of the peak is a ratio: of a force that the brakes make, and of what the tyre gives. Neither is known. The ratio
that is exceeded with the probability of so many standard deviations has both in it (Geary 1930; Hinkley 1969), and is
less than the product of the worst of each. The choices of theta have the tyre's part already; this is the rest.
"""

from __future__ import annotations

import numpy as np

from estimator.belief.revision import learns_effects
from hil_gateway.bus.messages import ModelRevision
from hil_gateway.process.arrays import Array

WIDEST = 0.45
"""standard deviations over their mean, times the level over two: wider beliefs have no such ratio"""


def brake_spread(revision: ModelRevision) -> tuple[float, float]:
    """Relative standard deviation of the braking force of front and rear axle at a given command, by the covariance of
    C_x, gain and share; nothing for a model that learns no brakes."""
    brakes = next((e for e in revision.effects if e.name == "front_brake"), None)
    if brakes is None or not learns_effects(revision):
        return 0.0, 0.0
    share = brakes.parameters["share"]
    value = {"cx": revision.tyre["cx"], "front_brake.share": share, "front_brake.gain": brakes.parameters["gain"]}
    names = [*revision.tyre, *(f"{e.name}.{key}" for e in revision.effects for key in e.parameters)]
    rows = np.array([names.index(name) for name in value])
    covariance = np.array(revision.covariance)[rows[:, None], rows]
    slopes = 1.0 / np.array([list(value.values())] * 2)
    slopes[1, 1] = -1.0 / (1.0 - share)
    front, rear = np.sqrt(np.maximum(np.einsum("ai,ij,aj->a", slopes, covariance, slopes), 0.0)).tolist()
    return front, rear


def brake_doubt(brakes: tuple[float, float], peaks: Array, level: float) -> tuple[float, float]:
    """How many times braking forces of front and rear axle count, from the relative standard deviations of the
    `brakes` and of the `peaks` (2,) of the tyres, so that with those of the tyres `level` of both together are held."""
    force, grip = (np.minimum(level * np.array(std), 2.0 * WIDEST) for std in (brakes, peaks))
    root = np.sqrt(1.0 - (1.0 - grip**2) * (1.0 - force**2))
    front, rear = ((1.0 + root) / (1.0 + grip)).tolist()
    return front, rear
