"""The `hil` command: one module a verb."""
