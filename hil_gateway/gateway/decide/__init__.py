"""Failsafe, race control and command checks: what the gateway does this period, and why."""
