"""Physics of the simulated car: tyres, chassis, driveline, road; the numbers and the switches of its effects."""
