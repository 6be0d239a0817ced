"""Command line of the estimator package: one module a verb."""
