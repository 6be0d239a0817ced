"""Findings about what is on the bus: load, messages, rates, lengths, counters, time stamps. Pure."""

from __future__ import annotations

from collections.abc import Iterator

from can_dbc.database import BusMessage, id_text
from can_dbc.signals import SignalMap
from hil_gateway.gateway.check.finding import Finding, Verdict
from hil_gateway.gateway.check.observation import Observation, TrafficRecord
from hil_gateway.gateway.perceive.vehicle_state import REQUIRED
from hil_gateway.process.model import Model

RATE_TOLERANCE = 0.2
"""A message this far from its period is named, share."""
LOAD_WARN = 0.8
"""Above this share of the bus the messages of low priority come late."""
READ_DELAY_WARN_S = 0.01
OUT_OF_ORDER_SHARE = 0.001
"""Two senders on two processor cores may be stamped a microsecond the wrong way round."""
COUNTER_SHARE = 0.9
"""A layout is believed when its counter advances by one this often."""


class MessageRow(Model):
    """One message of the DBC as it was seen."""

    name: str
    id: int
    direction: str
    expected_hz: float
    hz: float
    frames: int
    longest_gap_ms: float | None
    wrong_lengths: dict[int, int]
    counter: str
    verdict: Verdict
    detail: str


def message_rows(seen: Observation) -> list[MessageRow]:
    """Every message of the DBC with its verdict, by identifier."""
    return [_row(seen, record) for record in seen.records.values()]


def _row(seen: Observation, record: TrafficRecord) -> MessageRow:
    layout = record.layout
    hz = record.rate_hz(seen.seconds)
    gap = record.longest_gap_s(seen.start_ns, seen.end_ns) if record.frames else None
    verdict, detail = _judge(record, hz, gap, seen.signals)
    return MessageRow(
        name=layout.name,
        id=layout.id,
        direction=layout.direction,
        expected_hz=1 / layout.period_s,
        hz=hz,
        frames=record.frames,
        longest_gap_ms=None if gap is None else 1e3 * gap,
        wrong_lengths=dict(record.wrong_lengths),
        counter=_counter(record),
        verdict=verdict,
        detail=detail,
    )


def _weight(layout: BusMessage, signals: SignalMap) -> Verdict:
    """How much a problem with this message matters."""
    sources = [name for name, messages in signals.sources.items() if layout.name in messages]
    if any(name in REQUIRED or name == f"imu.{signals.imus[0]}" for name in sources):
        return Verdict.FAIL
    return Verdict.WARN if sources else Verdict.INFO


def _judge(record: TrafficRecord, hz: float, gap_s: float | None, signals: SignalMap) -> tuple[Verdict, str]:
    """The worst that can be said of a message."""
    if record.layout.direction == "computer":
        return _judge_command(record, signals)
    return next(_problems(record, hz, gap_s, _weight(record.layout, signals)), (Verdict.OK, ""))


def _problems(record: TrafficRecord, hz: float, gap_s: float | None, weight: Verdict) -> Iterator[tuple[Verdict, str]]:
    """Worst first; `weight` is what it matters."""
    layout = record.layout
    expected_hz = 1 / layout.period_s
    if record.wrong_lengths:
        lengths = ", ".join(f"{length} bytes" for length in sorted(record.wrong_lengths))
        yield Verdict.FAIL, f"{lengths} where the DBC says {layout.dlc}: another version of the car's DBC?"
    if gap_s is None:
        yield weight, "missing"
        return
    counter = _counter(record)
    if counter in ("stuck", "wrong"):
        yield weight, f"counter {counter}: the sender hangs, or another version of the car's DBC"
    timing = Verdict.INFO if weight is Verdict.INFO else Verdict.WARN
    if abs(hz - expected_hz) > RATE_TOLERANCE * expected_hz:
        yield timing, f"{hz:.1f} Hz where {expected_hz:g} Hz are due"
    if gap_s > layout.deadline_s:
        yield timing, f"silent for {1e3 * gap_s:.0f} ms"
    if counter == "gaps":
        yield Verdict.WARN, f"{_missing(record)} frames lost by its counter"


def _judge_command(record: TrafficRecord, signals: SignalMap) -> tuple[Verdict, str]:
    """Messages only a computer sends: nobody should, unless a gateway is running beside this check."""
    if not record.frames and not record.wrong_lengths:
        return Verdict.OK, ""
    verdict = Verdict.WARN if record.layout.name in signals.actuator_messages else Verdict.INFO
    return verdict, "somebody sends this: a gateway that is running, or a second computer"


def _counter(record: TrafficRecord) -> str:
    """none, ok, gaps (frames lost), wrong (advances by anything) or stuck."""
    steps, total = record.steps, record.steps.total()
    if record.layout.counter is None or total == 0:
        return "none"
    if steps[0] == total:
        return "stuck"
    if steps[1] == total:
        return "ok"
    return "gaps" if steps[1] >= COUNTER_SHARE * total else "wrong"


def _missing(record: TrafficRecord) -> int:
    return sum((step - 1) * count for step, count in record.steps.items() if step > 1)


def judge_bus(seen: Observation, bitrate: int, lost: int, malformed: int) -> list[Finding]:
    """Load, losses, error frames and identifiers nobody declared."""
    area = "bus"
    if seen.frames == 0:
        remedy = "power the car, check wiring and bitrate; on a test bench start `hil plant run`"
        return [Finding(area=area, name="traffic", verdict=Verdict.FAIL, detail="no frame at all", remedy=remedy)]
    load, worst = (bits / seen.seconds / bitrate for bits in (seen.bits, seen.bits + seen.stuff_bits_max))
    findings = [
        Finding(
            area=area,
            name="load",
            verdict=Verdict.WARN if worst > LOAD_WARN else Verdict.OK,
            detail=f"{seen.frames / seen.seconds:.0f} frames/s, {load:.0%} of {bitrate} bit/s "
            f"(at most {worst:.0%} with bit stuffing)",
        )
    ]
    if lost:
        remedy = "a busy computer: run with real-time priority (deploy/systemd)"
        findings.append(_warn(area, "lost", f"{lost} frames reached this computer and were not read in time", remedy))
    if seen.error_frames:
        remedy = "termination, wiring, bitrate, a node that comes and goes"
        findings.append(_warn(area, "error frames", f"{seen.error_frames} error frames", remedy))
    if malformed:
        findings.append(_warn(area, "not data", f"{malformed} remote requests or foreign datagrams", ""))
    if seen.unknown:
        ids = ", ".join(f"{id_text(frame_id)} ({count})" for frame_id, count in seen.unknown.most_common(8))
        more = f" and {len(seen.unknown) - 8} more" if len(seen.unknown) > 8 else ""
        findings.append(
            _warn(area, "unknown identifiers", ids + more, "not in the DBC: another bus, or another car (--platform)")
        )
    return findings


def judge_stamps(seen: Observation, read_delay_s: float | None) -> list[Finding]:
    """Order of the kernel's time stamps, and how long frames lay unread (99th percentile, s)."""
    if read_delay_s is None:
        return []
    detail = f"{seen.backward_stamps} out of order, read after {1e3 * read_delay_s:.1f} ms (p99)"
    if seen.backward_stamps <= OUT_OF_ORDER_SHARE * seen.frames and read_delay_s <= READ_DELAY_WARN_S:
        return [Finding(area="bus", name="time stamps", verdict=Verdict.OK, detail=detail)]
    return [_warn("bus", "time stamps", detail, "a busy computer: run with real-time priority (deploy/systemd)")]


def _warn(area: str, name: str, detail: str, remedy: str) -> Finding:
    return Finding(area=area, name=name, verdict=Verdict.WARN, detail=detail, remedy=remedy)
