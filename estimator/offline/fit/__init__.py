"""Fits: equation error, output error, prediction error, recursive; and what the data determines."""
