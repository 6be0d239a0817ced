"""Read-only live page: subscribes, never publishes; nothing on it comes from another server."""
