"""Choosing and opening the link a configuration names."""

from __future__ import annotations

import errno
import socket
from typing import Literal

from hil_gateway.can_link.base import CanLink
from hil_gateway.config import CanConfig
from hil_gateway.process.errors import InputError

Kind = Literal["socketcan", "udp_multicast", "virtual"]


def resolve_kind(config: CanConfig) -> Kind:
    """What `auto` means here: SocketCAN where the channel exists, else UDP multicast on loopback."""
    if config.interface != "auto":
        return config.interface
    return "socketcan" if interface_exists(config.channel) else "udp_multicast"


def interface_exists(channel: str) -> bool:
    """Whether the kernel knows a network interface of this name."""
    try:
        socket.if_nametoindex(channel)
    except OSError:
        return False
    return True


def open_link(config: CanConfig) -> CanLink:
    """Open one end of the configured bus.

    Raises:
        InputError: no such interface, no SocketCAN in this kernel, port in use, not a multicast address.
    """
    kind = resolve_kind(config)
    try:
        if kind == "socketcan":
            from hil_gateway.can_link.socketcan import SocketCanLink

            return SocketCanLink(config.channel)
        if kind == "udp_multicast":
            from hil_gateway.can_link.udp import UdpLink

            return UdpLink(config.multicast_group, config.multicast_port)
    except OSError as error:
        raise InputError(_explain(kind, config, error)) from None
    from hil_gateway.can_link.virtual import VirtualLink

    return VirtualLink(config.channel)


def _explain(kind: Kind, config: CanConfig, error: OSError) -> str:
    """What is wrong and what to do, in one line."""
    if kind == "socketcan":
        return _explain_socketcan(config.channel, error)
    address = f"udp {config.multicast_group}:{config.multicast_port}"
    if error.errno == errno.EADDRINUSE:
        return f"{address}: the port is in use by another program; set can.multicast_port to a free one"
    return f"{address}: {error}; set can.multicast_group to an address of 239.0.0.0/8"


def _explain_socketcan(channel: str, error: OSError) -> str:
    if error.errno in (errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT):
        remedy = "run it under deploy/with-vcan, or set can.interface to udp_multicast"
        return f"CAN interface {channel}: this kernel has no SocketCAN; {remedy}"
    if error.errno == errno.ENODEV:
        remedy = (
            f"`ip link add {channel} type vcan && ip link set {channel} up`"
            if "vcan" in channel
            else "docs/bring-up.md"
        )
        return f"CAN interface {channel}: no such interface; see {remedy}, or set can.channel"
    return f"CAN interface {channel}: {error.strerror or error}; `ip -details link show {channel}` says more"
