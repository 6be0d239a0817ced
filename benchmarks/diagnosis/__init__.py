"""How right the diagnosis is: drives with known truth, by equations that are not the estimator's."""
