"""What the page shows, gathered from the bus into one JSON object."""

from __future__ import annotations

import math
from typing import Any

from hil_gateway.bus.interface import Bus, LatestReader
from hil_gateway.bus.messages import Alert, Belief, Plan, VehicleState
from hil_gateway.bus.topics import ALERT, BELIEF, OPERATOR, TOPICS, TRUTH
from hil_gateway.track.track import Track

ALERTS_SHOWN = 8
TRACK_POINTS = 600


class Feed:
    """Newest message of every topic but the plant's truth, which belongs to the referee alone."""

    def __init__(self, bus: Bus) -> None:
        self._readers = {t.key: LatestReader(bus, t) for t in TOPICS if t not in (TRUTH, ALERT, OPERATOR)}
        self._alert_queue = bus.subscribe(ALERT, depth=ALERTS_SHOWN)
        self._alerts: list[Alert] = []
        self._prior: Belief | None = None

    def snapshot(self, now_ns: int) -> dict[str, Any]:
        """Everything the page needs at this moment; ages in s, null before the first message."""
        for reader in self._readers.values():
            reader.update(now_ns)
        self._alerts = (self._alerts + self._alert_queue.poll(now_ns))[-ALERTS_SHOWN:]
        messages = {key.removeprefix("av24/"): _page_form(r.latest.message) for key, r in self._readers.items()}
        belief = self._readers[BELIEF.key].latest.message
        self._prior = self._prior or belief
        return {
            "stamp_s": now_ns / 1e9,
            "messages": messages,
            "ages": {key.removeprefix("av24/"): self._age(key, now_ns) for key in self._readers},
            "alerts": [alert.model_dump(mode="json") for alert in reversed(self._alerts)],
            "prior": list(self._prior.mean) if self._prior else None,
        }

    def _age(self, key: str, now_ns: int) -> dict[str, Any]:
        latest = self._readers[key].latest
        age_s = latest.age_s(now_ns)
        return {"age_s": None if math.isinf(age_s) else round(age_s, 3), "alive": latest.alive(now_ns)}


def _page_form(message: Any) -> dict[str, Any] | None:
    """A message as the page wants it: spreads instead of covariances, nothing that is not drawn."""
    if message is None:
        return None
    if isinstance(message, Belief):
        spread = [math.sqrt(max(row[i], 0.0)) for i, row in enumerate(message.covariance)]
        return {"names": message.names, "mean": message.mean, "std": spread, "samples": message.samples}
    if isinstance(message, Plan):
        return message.model_dump(mode="json", include={"x", "y", "status", "reason", "solve_ms", "lap", "revision"})
    if isinstance(message, VehicleState):
        return message.model_dump(mode="json", exclude={"position_seq"})
    return dict(message.model_dump(mode="json", exclude={"covariance"}))


def track_outline(track: Track) -> dict[str, Any]:
    """Both edges of the track, m, thinned for drawing."""
    import numpy as np

    step = max(len(track.x) // TRACK_POINTS, 1)
    normal_x, normal_y = -np.sin(track.heading), np.cos(track.heading)

    def edge(offset: Any) -> dict[str, list[float]]:
        x, y = track.x + offset * normal_x, track.y + offset * normal_y
        return {"x": np.round(x[::step], 2).tolist(), "y": np.round(y[::step], 2).tolist()}

    return {"name": track.name, "left": edge(track.width_left), "right": edge(-track.width_right)}
