"""Read-only live page: losing it changes nothing on the wire."""
