"""Identification of tyre and effect parameters from drive logs (paper, Eq. 6-8 and section III)."""
