"""Recordings from and to other tools: logs in, tables and logs out."""
