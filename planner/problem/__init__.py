"""The planning problem: motion, cost, constraints and information, stage by stage (Eq. 4, 5, 9, 10)."""
