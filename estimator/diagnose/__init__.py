"""Residual -> missing effect -> error before and after.

record -> predict (model over columns) -> fit (all parameters together, normal equations per lap) -> search
(greedy over the catalogue by held-out evidence) -> structure and empirical (what nothing in the catalogue
explains) -> score (on laps no fit or choice has seen) -> result, report.
"""
