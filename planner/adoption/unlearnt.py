"""What a planner does whose model nothing corrects: learning is off, and a data sheet is all that is known of the car.

A car that learns has the stiffness of its tyres within two or three seconds. One that does not is steered by the data
sheet for good. Two things follow:

- **Balance.** A car whose front axle responds more than the model says, against its rear axle, swings more with every
  correction: at 60 to 75 m/s it weaves until it spins, long before a tyre has reached its peak. One that responds less
  runs wide. So motion is predicted with the car that oversteers more: front tyres one standard deviation of the balance
  stiffer, and less where they are seen to respond less. How far that is, the covariance of the model says.
- **Reserves.** A force that a tyre has borne says where its peak is not, and nothing tells how far above that it is:
  asked for again after every swing that came higher, it ends at the peak, within a bend. So no load held counts, and
  every lap keeps what the first keeps back.
"""

from __future__ import annotations

import numpy as np

from hil_gateway.process.arrays import Array
from planner.adoption.usable_grip import Axles


def oversteering(theta: Array, covariance: Array, axles: Axles, response: float) -> Array:
    """`theta` (n,) with B of the front tyres times their `response`, within one relative standard deviation of B front
    over B rear; the same where both axles share one B."""
    (front, _, _), (rear, _, _) = axles
    gradient = np.zeros(len(theta))
    gradient[front] += 1.0 / theta[front]
    gradient[rear] -= 1.0 / theta[rear]
    factors = np.ones(len(theta))
    spread = np.sqrt(max(float(gradient @ covariance @ gradient), 0.0))
    factors[front] = np.clip(response, 1.0 - spread, 1.0 + spread)
    return np.asarray(factors * theta)
