"""Recorded drives as one table: readers, derived channels, smoothing, health."""
