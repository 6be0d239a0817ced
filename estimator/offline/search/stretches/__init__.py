"""Grip that differs on a stretch of the track in certain laps: found by cells, fitted as a term."""
