"""What a planner does whose model nothing corrects: learning is off, and a data sheet is all that is known of the car.

A car that learns has the stiffness of its tyres within two or three seconds. One that does not is steered by the data
sheet for good. Two things follow:

- **Balance.** A car whose front axle responds more than the model says, against its rear axle, swings more with every
  correction: at 60 to 75 m/s it weaves until it spins, long before a tyre has reached its peak. One that responds less
  runs wide. So until a bend shows how the front tyres respond, motion is predicted with the car that oversteers more:
  they are one standard deviation of the balance stiffer; with more, ordinary cars run wide in their first bend. Then
  they count as they respond, within the deviations that a first lap keeps back.
- **Reserves.** A force that a tyre has borne says where its peak is not, and nothing tells how far above that it is:
  asked for again after every swing that came higher, it ends at the peak, within a bend. So no load held counts, and
  every lap keeps what the first keeps back.
"""

from __future__ import annotations

import numpy as np

from hil_gateway.process.arrays import Array
from planner.adoption.usable_grip import Axles


def oversteering(theta: Array, covariance: Array, axles: Axles, response: float, level: float) -> Array:
    """`theta` (n,) with B of the front tyres times their `response`, within `level` relative standard deviations of B
    front over B rear, or one stiffer while none is known (inf); the same where both axles share one B."""
    (front, _, _), (rear, _, _) = axles
    gradient = np.zeros(len(theta))
    gradient[front] += 1.0 / theta[front]
    gradient[rear] -= 1.0 / theta[rear]
    spread = np.sqrt(max(float(gradient @ covariance @ gradient), 0.0))
    most = 1.0 + (1.0 if np.isinf(response) else level) * spread
    factors = np.ones(len(theta))
    factors[front] = np.clip(response, 1.0 / most, most)
    return np.asarray(factors * theta)
