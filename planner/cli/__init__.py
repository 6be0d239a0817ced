"""Command line of the planner package: one module a verb."""
