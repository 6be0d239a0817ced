"""State of a CAN interface as the kernel reports it (`ip -details -statistics -json link show`)."""

from __future__ import annotations

import json
import shutil
import subprocess
from typing import Any

from hil_gateway.gateway.check.finding import Finding, Verdict
from hil_gateway.process.model import Model

AREA = "interface"


class Interface(Model):
    """What there is to know before the first frame. None where this kind of interface has no such thing."""

    channel: str
    kind: str
    """can (a controller), vcan, vxcan, slcan"""
    up: bool
    state: str | None = None
    """fault confinement state: ERROR-ACTIVE, ERROR-WARNING, ERROR-PASSIVE, BUS-OFF, STOPPED"""
    bitrate: int | None = None
    sample_point: float | None = None
    restart_ms: int | None = None
    listen_only: bool | None = None
    transmit_errors: int | None = None
    receive_errors: int | None = None
    bus_offs: int | None = None
    dropped: int | None = None


def read_interface(channel: str) -> Interface | None:
    """Ask the kernel; None where there is no such interface or no iproute2."""
    if shutil.which("ip") is None:
        return None
    command = ["ip", "-details", "-statistics", "-json", "link", "show", "dev", channel]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    return parse_interface(json.loads(answer.stdout)[0]) if answer.returncode == 0 else None


def parse_interface(link: dict[str, Any]) -> Interface:
    """One object of iproute2's JSON."""
    info = link.get("linkinfo", {})
    data, counts = info.get("info_data", {}), info.get("info_xstats", {})
    timing, errors = data.get("bittiming", {}), data.get("berr_counter", {})
    is_controller = info.get("info_kind") == "can"
    return Interface(
        channel=link["ifname"],
        kind=info.get("info_kind", link.get("link_type", "unknown")),
        up="UP" in link.get("flags", ()),
        state=data.get("state"),
        bitrate=timing.get("bitrate"),
        sample_point=None if timing.get("sample_point") is None else float(timing["sample_point"]),
        restart_ms=data.get("restart_ms", 0) if is_controller else None,
        listen_only="LISTEN-ONLY" in data.get("ctrlmode", ()) if is_controller else None,
        transmit_errors=errors.get("tx"),
        receive_errors=errors.get("rx"),
        bus_offs=counts.get("bus_off"),
        dropped=link.get("stats64", {}).get("rx", {}).get("dropped"),
    )


def judge_interface(interface: Interface, bitrate: int) -> list[Finding]:
    """Findings about the interface itself; `bitrate` is what the configuration says, bit/s."""
    up = f"ip link set {interface.channel} up type can bitrate {bitrate} restart-ms 100"
    if interface.kind in ("vcan", "vxcan"):
        up = f"ip link set {interface.channel} up"
    if not interface.up:
        return [Finding(area=AREA, name="link", verdict=Verdict.FAIL, detail="the interface is down", remedy=up)]
    findings = [Finding(area=AREA, name="link", verdict=Verdict.OK, detail=f"{interface.kind}, up")]
    if interface.kind == "can":
        findings += [_state(interface), _bitrate(interface, bitrate), _restart(interface), _listen_only(interface)]
    return findings


def _state(interface: Interface) -> Finding:
    errors = f"error counters tx {interface.transmit_errors}, rx {interface.receive_errors}"
    verdict = {"ERROR-ACTIVE": Verdict.OK, "ERROR-WARNING": Verdict.WARN}.get(interface.state or "", Verdict.FAIL)
    if verdict is Verdict.OK and interface.bus_offs:
        verdict = Verdict.WARN
    remedy = "" if verdict is Verdict.OK else "wrong bitrate, missing 120 ohm termination, swapped or open wires"
    detail = f"{interface.state}, {errors}, bus-off {interface.bus_offs or 0} times"
    return Finding(area=AREA, name="controller", verdict=verdict, detail=detail, remedy=remedy)


def _bitrate(interface: Interface, bitrate: int) -> Finding:
    point = f", sample point {interface.sample_point:.1%}" if interface.sample_point else ""
    detail = f"{interface.bitrate} bit/s{point}"
    if interface.bitrate == bitrate:
        return Finding(area=AREA, name="bitrate", verdict=Verdict.OK, detail=detail)
    remedy = f"ip link set {interface.channel} down; ip link set {interface.channel} up type can bitrate {bitrate}"
    detail += f", the configuration says {bitrate} (can.bitrate)"
    return Finding(area=AREA, name="bitrate", verdict=Verdict.FAIL, detail=detail, remedy=remedy)


def _restart(interface: Interface) -> Finding:
    if interface.restart_ms:
        detail = f"after {interface.restart_ms} ms"
        return Finding(area=AREA, name="restart after bus-off", verdict=Verdict.OK, detail=detail)
    return Finding(
        area=AREA,
        name="restart after bus-off",
        verdict=Verdict.WARN,
        detail="never by itself",
        remedy=f"ip link set {interface.channel} type can restart-ms 100 (deploy/can does it)",
    )


def _listen_only(interface: Interface) -> Finding:
    """Listen-only is right for the first contact, and in the way of driving."""
    detail = "on: the controller cannot transmit" if interface.listen_only else "off: frames are acknowledged"
    return Finding(area=AREA, name="listen-only", verdict=Verdict.INFO, detail=detail)
