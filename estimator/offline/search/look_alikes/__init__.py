"""Look-alikes of effects: found as candidates, told as unexplained."""
