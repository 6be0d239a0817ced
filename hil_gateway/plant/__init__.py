"""The simulated AV-24: the other end of the CAN cable. It speaks CAN only and shares no equation with the estimator."""
