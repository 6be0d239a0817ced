"""One result of the check."""

from __future__ import annotations

from enum import StrEnum

from hil_gateway.process.model import Model


class Verdict(StrEnum):
    """How bad it is: `fail` prevents driving, `warn` is to be examined, `info` is for information."""

    OK = "ok"
    INFO = "info"
    WARN = "warn"
    FAIL = "fail"


class Finding(Model):
    """What was looked at, how it is, and what to do about it."""

    area: str
    name: str
    verdict: Verdict
    detail: str
    remedy: str = ""
