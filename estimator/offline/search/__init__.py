"""Search for effects the model lacks: screening, trials, evidence, empirical terms."""
