"""The event log: what changed in the loop, written beside the gateway and never part of its decisions."""
