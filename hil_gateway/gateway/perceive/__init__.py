"""Frames to vehicle state, with counters, ages and plausibility of every source."""
