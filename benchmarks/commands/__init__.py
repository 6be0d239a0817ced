"""Front door of the laboratory: `hil campaign` and `hil verify`."""
