"""Scores, typed results, and the model revision handed to the car."""
