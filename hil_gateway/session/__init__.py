"""Recorded sessions: one MCAP file with every raw CAN frame and every message of the topics table.

`format` says what a session holds, `writer` writes it, `reader` reads it however it ended, and the commands of
`hil session` are `info`, `recover`, `export`, `import` and `replay`.
"""
