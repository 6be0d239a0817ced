"""The vehicle controller of the simulated car: what stands on its CAN, and what it makes of commands."""
