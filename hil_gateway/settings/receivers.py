"""Settings of receivers on the network; what is known of the receivers themselves stands in the car folder."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from hil_gateway.process.model import Model


class ReceiverConfig(Model):
    """Where a receiver is read, and what tells how old its logs are."""

    address: str = Field(description="tcp://HOST:PORT, or a serial device")
    baud: Literal[9600, 115200, 230400, 460800] = Field(default=115200, description="of a serial line")
    clock: Literal["arrival", "gps"] = Field(
        default="arrival",
        description="gps: this computer's clock keeps GPS time (PTP, PPS), and ages are measured; arrival: the fastest "
        "logs are as late as the car folder says (delay)",
    )
