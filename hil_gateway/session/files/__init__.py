"""Recordings on disk: format, writing, reading, recovery."""
