"""The simulated AV-24: the other end of the CAN cable. Speaks CAN only; never imports estimator or planner."""
