"""A recording sent again, on the bus or on CAN."""
