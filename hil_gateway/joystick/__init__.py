"""A person at a joystick or wheel, as one more source of commands."""
