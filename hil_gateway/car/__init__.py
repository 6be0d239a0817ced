"""Declared facts of the car: vehicle, powertrain, and the conversion between commands and actuators."""
