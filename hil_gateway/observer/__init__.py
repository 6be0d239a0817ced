"""What a car is like, learnt while it drives, and whether a sensor fits the others and the car.

What is constant or slow about a car (steering zero, tyres, rolling radii, offsets of sensors) is a state with a
declared deviation. A source is judged by a filter that does without it, against the variance that this filter predicts:
solution separation, as in the monitoring of satellite receivers (J. Blanch et al., Advanced RAIM user algorithm
description, ION GNSS 2012). Pure: time is an argument.
"""
