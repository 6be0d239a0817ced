"""What is not known of the brakes, as a factor on what their forces count beside tyres of unknown grip (Eq. 10).

A share of the peak is a ratio: of a force that the brakes make, and of what the tyre gives. Neither is known. The ratio
that is exceeded with the probability of so many standard deviations has both in it (Geary 1930; Hinkley 1969), and is
less than the product of the worst of each. The choices of theta have the tyre's part already; this is the rest.
"""

from __future__ import annotations

import numpy as np

from estimator.belief.revision import effect_values, learns_effects
from estimator.model.parameters import Quantity
from hil_gateway.bus.messages import ModelRevision
from hil_gateway.process.arrays import Array

WIDEST = 0.45
"""standard deviations over their mean, times the level over two: wider beliefs have no such ratio"""


def brake_spread(revision: ModelRevision) -> tuple[float, float]:
    """Relative standard deviation of the braking force of front and rear axle at a given command, by the covariance of
    C_x, gain and share; nothing for a model that learns no brakes."""
    effects = effect_values(revision)
    if Quantity.FRONT_BRAKE_SHARE not in effects or not learns_effects(revision):
        return 0.0, 0.0
    (place, share), (other, gain) = effects[Quantity.FRONT_BRAKE_SHARE], effects[Quantity.BRAKE_GAIN]
    rows = [*revision.tyre].index("cx"), place, other
    covariance = np.array([[revision.covariance[i][j] for j in rows] for i in rows])
    slopes = 1.0 / np.array([[revision.tyre["cx"], share, gain]] * 2)
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
