"""The newest snapshot as Prometheus reads it: text exposition format 0.0.4, seconds and totals as it names them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

MEDIA_TYPE = "text/plain; version=0.0.4; charset=utf-8"
COUNTERS = {
    "gateway_status": ("frames_received", "frames_lost", "counter_errors", "commands_sent", "commands_limited"),
    "recorder_status": ("frames", "messages", "lost", "errors", "bytes_written"),
}
"""message -> fields that only grow while its sender runs"""
MILLISECONDS = {"gateway_status": ("loop_latency_p50_ms", "loop_latency_p99_ms"), "plan": ("solve_ms",)}
STATES = {"gateway_status": ("action", "mode", "bus_state"), "plan": ("status",)}
"""message -> fields that hold one of a few words"""

Sample = tuple[str, str, str, float]
"""metric, type, labels, value"""


def exposition(snapshot: Mapping[str, Any]) -> str:
    """Every metric of a snapshot of the feed; of a source that has fallen silent only how old it is."""
    lines, typed = [], set[str]()
    for name, kind, labels, value in sorted(_samples(snapshot)):
        if name not in typed:
            typed.add(name)
            lines.append(f"# TYPE {name} {kind}")
        lines.append(f"{name}{labels} {value:.12g}")
    return "\n".join(lines) + "\n"


def _samples(snapshot: Mapping[str, Any]) -> Iterator[Sample]:
    for topic, age in snapshot["ages"].items():
        yield "hil_topic_alive", "gauge", f'{{topic="{topic}"}}', float(age["alive"])
        if age["age_s"] is not None:
            yield "hil_topic_age_seconds", "gauge", f'{{topic="{topic}"}}', age["age_s"]
        if age["alive"]:
            yield from _of_message(topic, snapshot["messages"][topic])


def _of_message(topic: str, message: Mapping[str, Any]) -> Iterator[Sample]:
    source = f"hil_{topic.removesuffix('_status')}"
    for field in COUNTERS.get(topic, ()):
        yield f"{source}_{field}_total", "counter", "", float(message[field])
    for field in MILLISECONDS.get(topic, ()):
        if message[field] is not None:
            yield f"{source}_{field.removesuffix('_ms')}_seconds", "gauge", "", message[field] / 1e3
    for field in STATES.get(topic, ()):
        yield f"{source}_{field}", "gauge", f'{{{field}="{_label(message[field])}"}}', 1.0


def _label(text: str) -> str:
    """Text as a label's value may hold it: what a sender writes ends neither the value nor the line."""
    return text.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")
