"""Runs: how far a car may go in this one, where in it the car is, and where it stops."""
