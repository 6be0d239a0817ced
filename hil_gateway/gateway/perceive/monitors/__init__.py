"""Sensors that lie and actuators that do not follow, by what other signals say; one small class each."""
