"""The shell around the check: open the link, listen, judge, print."""

from __future__ import annotations

import sys
from dataclasses import dataclass

from can_dbc.database import id_text
from hil_gateway.can_link import CanLink, Frame, LinkStats, open_link
from hil_gateway.config import Config
from hil_gateway.gateway.check.arming import missing_for_arming
from hil_gateway.gateway.check.finding import Verdict
from hil_gateway.gateway.check.interface import Interface, judge_interface, read_interface
from hil_gateway.gateway.check.observation import observe
from hil_gateway.gateway.check.plausibility import judge_signals
from hil_gateway.gateway.check.report import Report, count, print_report
from hil_gateway.gateway.check.traffic import judge_bus, judge_stamps, message_rows
from hil_gateway.process.clock import NS_PER_S, Clock, SystemClock
from hil_gateway.process.errors import EXIT_FAILURE, InputError

FRAMES_MAX = 2_000_000
"""Bound of a capture: four minutes of a full bus."""
WAIT_S = 0.01


@dataclass(frozen=True, slots=True)
class Capture:
    """A stretch of traffic."""

    frames: list[Frame]
    start_ns: int
    end_ns: int
    read_delay_s: float | None
    """99th percentile of stamp to read"""
    stats: LinkStats


def capture(link: CanLink, clock: Clock, seconds: float) -> Capture:
    """Listen for `seconds`, never longer; nothing is sent."""
    frames: list[Frame] = []
    delays: list[int] = []
    link.receive()  # what came before the stretch began
    start_ns = now_ns = clock.now_ns()
    end_ns = start_ns + int(seconds * NS_PER_S)
    while now_ns < end_ns and len(frames) < FRAMES_MAX:
        arrived = link.receive(WAIT_S)
        now_ns = clock.now_ns()
        frames += arrived
        delays += [now_ns - frame.stamp_ns for frame in arrived[:1]]  # the oldest of a batch has waited longest
    delays.sort()
    delay_s = delays[int(0.99 * (len(delays) - 1))] / NS_PER_S if delays else None
    return Capture(frames, start_ns, max(now_ns, start_ns + 1), delay_s, link.stats())


def examine(config: Config, bus: str, interface: Interface | None, captured: Capture) -> Report:
    """Everything that can be said about a capture. Pure."""
    codec = config.car.codec
    bitrate = config.can.bitrate or codec.bitrate
    seen = observe(captured.frames, codec, captured.start_ns, captured.end_ns)
    messages = tuple(message_rows(seen)) if seen.frames else ()
    findings = (
        *(judge_interface(interface, bitrate) if interface else ()),
        *judge_bus(seen, bitrate, captured.stats.lost, captured.stats.malformed),
        *judge_stamps(seen, captured.read_delay_s),
        *judge_signals(seen, config),
    )
    return Report(
        channel=config.can.channel
        if bus == "socketcan"
        else f"{config.can.multicast_group}:{config.can.multicast_port}",
        bus=bus,
        seconds=seen.seconds,
        dbc_version=codec.version,
        frames=seen.frames,
        interface=interface,
        findings=findings,
        messages=messages,
        unknown={id_text(frame_id): number for frame_id, number in seen.unknown.most_common()},
        missing_for_arming=missing_for_arming(config, captured.frames, captured.start_ns, captured.end_ns),
        failures=count(Verdict.FAIL, findings, messages),
        warnings=count(Verdict.WARN, findings, messages),
    )


def run_check(config: Config, channel: str | None = None, seconds: float = 5.0, as_json: bool = False) -> int:
    """`hil gateway check`: exit code 0, or 1 when something stands in the way of driving.

    `channel` names a SocketCAN interface; without it the configured bus is listened to.

    Raises:
        InputError: no such interface, a duration that is not positive.
    """
    if not 0.1 <= seconds <= 3600:
        raise InputError(f"--seconds {seconds:g}: between 0.1 and 3600")
    if channel is not None:
        can = config.can.model_copy(update={"channel": channel, "interface": "socketcan"})
        config = config.model_copy(update={"can": can})
    link = open_link(config.can)
    try:
        interface = read_interface(config.can.channel) if link.kind == "socketcan" else None
        print(f"listening for {seconds:g} s, nothing is sent ...", file=sys.stderr)
        captured = capture(link, SystemClock(), seconds)
    finally:
        link.close()
    report = examine(config, link.kind, interface, captured)
    _print(report, as_json)
    return EXIT_FAILURE if report.failures else 0


def _print(report: Report, as_json: bool) -> None:
    if as_json:
        print(report.model_dump_json())
        return
    from rich.console import Console

    print_report(report, Console(width=None if sys.stdout.isatty() else 140))
