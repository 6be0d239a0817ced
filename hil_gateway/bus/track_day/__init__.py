"""What people ask for and say during a day at the track: runs, flags of the simulated car, notes."""
