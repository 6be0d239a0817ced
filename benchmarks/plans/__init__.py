"""Measurements of the planner: benchmark, contraction, safety, campaigns."""
