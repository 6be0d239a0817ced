"""The CAN cable as the rest of the project sees it: one interface, four kinds of bus behind it.

`socketcan` is the car and vcan; `udp_multicast` lets processes of one computer meet where the kernel has no
CAN; `virtual` joins threads of one process; `VirtualWire` joins single-process loops on a virtual clock.
"""

from __future__ import annotations

from hil_gateway.can_link.base import EXTENDED_ID, BusState, CanLink, Frame, LinkStats
from hil_gateway.can_link.opening import open_link, resolve_kind
from hil_gateway.can_link.wire import VirtualWire

__all__ = ["EXTENDED_ID", "BusState", "CanLink", "Frame", "LinkStats", "VirtualWire", "open_link", "resolve_kind"]
