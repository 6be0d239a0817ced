"""Bring-up check: listen to a bus and say what is there, what is not, and what arming still needs.

Nothing is ever sent: the link is only read, and the gateway core that answers for arming runs afterwards on the
captured frames, on a link that refuses to transmit.
"""

from __future__ import annotations

from hil_gateway.gateway.check.run import run_check

__all__ = ["run_check"]
