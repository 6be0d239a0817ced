"""Judges by the truth of the plant: laps, excursions, friction used, and the least lap time of the very car."""
