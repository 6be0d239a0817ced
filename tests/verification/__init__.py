"""Verification tools: promises, mutation, wire judge, fault simulation."""
