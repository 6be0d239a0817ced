"""What a user did or gave that cannot be used: one clear line, exit code 2.

An `InputError` says what is wrong, the value, the limit, where (file, row, key) and what to do.
Anything else that is raised is a bug.
"""

from __future__ import annotations

from hil_gateway.process.figures import printable

EXIT_FAILURE = 1
"""the run found a failure: a test, a check, a lost frame"""
EXIT_INPUT = 2
"""bad arguments or input"""
EXIT_SIGNAL = 128
"""plus the number of the signal that ended a command early, as a shell says it: 130 after Ctrl-C"""


LINE_MAX = 1000
"""characters of a message: names, keys and values in it are as long as who wrote the input made them"""


class InputError(Exception):
    """Bad input; the message is what the user reads."""


def one_line(error: Exception) -> str:
    """The message as a terminal may show it: control characters as escapes, and the middle left out of a long one."""
    text = printable(str(error))
    return text if len(text) <= LINE_MAX else f"{text[: LINE_MAX // 2]} ... {text[-LINE_MAX // 4 :]}"
