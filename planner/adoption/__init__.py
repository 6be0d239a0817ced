"""Which model the planner drives with."""
