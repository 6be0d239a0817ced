"""Where the car is, by its receivers: on its bus, or on the network."""
