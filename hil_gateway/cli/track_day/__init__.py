"""Commands of a day at the track, and how they reach running processes."""
