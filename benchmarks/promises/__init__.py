"""The promises: what each asks, the tests that prove it, mutation, and the independent judge of the wire."""
