"""AV-24 CAN database: the DBC, what a DBC cannot say, and the codecs compiled from both."""
