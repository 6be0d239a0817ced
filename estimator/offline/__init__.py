"""Identification and diagnosis of recorded drives: record -> predict -> fit -> search -> result -> report."""
