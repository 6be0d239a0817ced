"""The page of a day at the track."""
