"""What processes say to each other: messages, topics, who may publish what, and the Zenoh and local buses."""
