"""What a recording holds: laps, stops, figures, lists of recordings."""
