"""Experiments on the plant alone, with a scripted driver."""
