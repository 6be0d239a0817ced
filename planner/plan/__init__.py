"""One plan: predicted state, solution, acceptance, fallback."""
