"""Drives outside the campaigns: the plant alone with a scripted driver, and the loop of real processes."""
