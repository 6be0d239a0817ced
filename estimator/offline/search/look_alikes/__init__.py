"""Wheels that swing about their steering axis: found as a candidate, told as unexplained."""
