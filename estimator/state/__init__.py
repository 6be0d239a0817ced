"""State estimation: Kalman filter over the vehicle states, alignment and recovery."""
