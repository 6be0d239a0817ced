"""State estimation, tyre identification (Eq. 6-8) and diagnosis of what the model lacks."""
