"""THE vehicle model, symbolic in CasADi, written once: estimator, diagnosis and planner all evaluate this one.

parameters -> tyre (Eq. 2, 3) -> single_track (Eq. 1) with effects/ hooked in -> measurement.
"""
