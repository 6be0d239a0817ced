"""Monitors that find wrong sensors and actuators by the signals that contradict them; one small class each."""
