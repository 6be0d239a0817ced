"""A day at the track: what its recordings hold together, and its sharing."""
