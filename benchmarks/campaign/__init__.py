"""Long comparisons over seeds: driving to learn, and the loop closed by diagnosis."""
