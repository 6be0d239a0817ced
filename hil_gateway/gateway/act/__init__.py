"""From the decision to frames: stopping, limits, transmission."""
