"""What is still needed before the gateway would arm: asked of the gateway core itself, on the captured frames."""

from __future__ import annotations

from collections.abc import Sequence

from hil_gateway.bus import topics
from hil_gateway.bus.interface import LocalBus
from hil_gateway.can_link import Frame, LinkStats
from hil_gateway.config import Config
from hil_gateway.gateway.core import Gateway
from hil_gateway.gateway.decide.failsafe import IN_EMERGENCY, TABLE
from hil_gateway.settings.gateway import PERIOD_NS

EXPLANATION = {row.cause: row.explanation for row in TABLE} | {
    "car_moving": "the car must stand still, and valid reports say so",
    "mode": "gateway.mode is listen",
    "estimate_unfit": "the estimate is not where the position fixes are",
    "disagreement": "estimator or planner works with another track or car",
    "run_lost": "the planner was started anew and knows nothing of the run",
    "plan_standing": "the planner has no plan that drives off",
    "mode_without_crank": "gateway.mode is not armed",
    "car_not_crank_ready": "the car has not answered the ladder up to crank ready (sys_state 5)",
    "cranked": "the ladder is beyond cranking already",
    IN_EMERGENCY: "in emergency: remove its cause, then `hil gateway disarm`",
}
"""What `missing_for_arming` and `missing_for_crank` name -> what a person reads."""


class PlaybackLink:
    """A link that replays captured frames by their stamps and refuses to transmit."""

    kind = "playback"

    def __init__(self, frames: Sequence[Frame]) -> None:
        self._frames = frames
        self._next = 0
        self.now_ns = 0

    def receive(self, timeout_s: float = 0.0) -> list[Frame]:
        """Frames up to `now_ns`."""
        start = self._next
        while self._next < len(self._frames) and self._frames[self._next].stamp_ns <= self.now_ns:
            self._next += 1
        return list(self._frames[start : self._next])

    def send(self, frame_id: int, data: bytes) -> bool:
        """Never."""
        return False

    def stats(self) -> LinkStats:
        return LinkStats()

    def close(self) -> None:
        """Nothing to release."""


def missing_for_arming(config: Config, frames: Sequence[Frame], start_ns: int, end_ns: int) -> tuple[str, ...]:
    """Causes that would refuse arming at `end_ns`, as the gateway's failsafe names them."""
    shadow = config.model_copy(update={"gateway": config.gateway.model_copy(update={"mode": "shadow"})})
    bus, playback = LocalBus(), PlaybackLink(frames)
    gateway = Gateway(shadow, bus, playback)
    status = bus.subscribe(topics.GATEWAY_STATUS)
    for now_ns in range(start_ns, end_ns + 1, PERIOD_NS):
        playback.now_ns = now_ns
        gateway.step(now_ns)
    newest = status.poll(end_ns)
    return newest[-1].missing_for_arming if newest else ()
