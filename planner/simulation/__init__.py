"""The whole loop in one process on a virtual clock."""
