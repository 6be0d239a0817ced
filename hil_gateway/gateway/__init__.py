"""The gateway process: perceive, decide, act, 100 times a second; and the bring-up check."""
