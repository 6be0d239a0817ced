"""CAN logs of any program, read as one stream of frames: a format a module, recognised by what the file holds."""
