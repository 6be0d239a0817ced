"""Everything that touches wire, disk, clock or safety, and the message schemas the other packages speak."""
