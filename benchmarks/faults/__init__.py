"""Deterministic fault simulation: the whole loop on a virtual clock, faults by seed, the promises as invariants."""
