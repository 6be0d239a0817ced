"""Diagnosis in the background while the car drives."""
