"""What a planner does whose model nothing corrects: learning is off, and a data sheet is all that is known of the car.

A car that learns has the stiffness of its tyres within two or three seconds. One that does not is steered by the data
sheet for good. Two things follow:

- **Balance.** A car whose front axle responds more than the model says, against its rear axle, swings more with every
  correction: at 60 to 75 m/s it weaves until it spins, long before a tyre has reached its peak. One that responds less
  runs wide. So motion is predicted with the car that oversteers more: front tyres one standard deviation of the balance
  stiffer, and less where they are seen to respond less. How far that is, the covariance of the model says.
- **Loads held.** What the model says an axle has borne is no evidence where nothing corrects the model: a weak axle
  slips more, which to the model is more force, and more would be asked for. What was measured counts.
"""

from __future__ import annotations

import numpy as np

from estimator.model.tyre import normalised_force
from hil_gateway.bus.messages import Estimate
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array
from planner.adoption.trust import JUDGED_SPEED, slip_angles
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


def measured_loads(estimate: Estimate, mean: Array, vehicle: Vehicle, axles: Axles) -> tuple[float, float]:
    """Lateral force over axle load (front, rear) of the last 0.1 s: by the believed tyres `mean` (n,), times the share
    of it that was delivered; 0 where too little was asked to tell."""
    shares = estimate.delivered
    if shares is None or estimate.vx < JUDGED_SPEED:
        return 0.0, 0.0
    rows = zip(slip_angles(estimate, vehicle), (shares.front, shares.rear), axles, strict=True)
    front, rear = (
        0.0 if share is None else max(share, 0.0) * float(normalised_force(np.array(abs(slip)), *mean[list(axle)]))
        for slip, share, axle in rows
    )
    return front, rear
