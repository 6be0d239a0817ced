"""Foxglove hears the running car: a client of its WebSocket protocol, in a real browser, gets what is on the bus."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.browser import CHROMIUM, Browser

from hil_gateway.bus import messages as m
from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.topics import ESTIMATE, TOPICS, TRUTH
from hil_gateway.config import Config
from hil_gateway.dashboard.foxglove_live import FoxgloveLive
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError
from hil_gateway.session.exchange.foxglove import CHANNELS, LOCATION, SCENE, TRANSFORM
from hil_gateway.track.loading import load_track

UNIX_NS = 1_700_000_000_123_456_789
CLIENT = """(() => {
  window.got = {}; window.topics = {}; window.capabilities = null;
  const socket = new WebSocket("ws://127.0.0.1:PORT", ["foxglove.sdk.v1"]);
  socket.binaryType = "arraybuffer";
  socket.onmessage = ({ data }) => {
    if (typeof data === "string") {
      const said = JSON.parse(data);
      if (said.op === "serverInfo") window.capabilities = said.capabilities;
      if (said.op !== "advertise") return;
      for (const { id, topic, schemaName } of said.channels) window.topics[topic] = [id, schemaName];
      const subscriptions = said.channels.map(({ id }) => ({ id, channelId: id }));
      socket.send(JSON.stringify({ op: "subscribe", subscriptions }));
      return;
    }
    const view = new DataView(data);
    if (view.getUint8(0) !== 1) return;
    const text = new TextDecoder().decode(new Uint8Array(data, 13));
    window.got[view.getUint32(1, true)] = [String(view.getBigUint64(5, true)), text];
  };
})()"""


@pytest.fixture
def bus() -> LocalBus:
    return LocalBus()


@pytest.fixture
def live(bus: LocalBus) -> Iterator[FoxgloveLive]:
    config = Config()
    served = FoxgloveLive(bus, load_track(config.track), config, "127.0.0.1", 0)
    yield served
    served.close()


def estimate(x: float) -> m.Estimate:
    return m.Estimate(
        stamp_ns=1, seq=1, state_stamp_ns=1, valid=True, x=x, y=-80.0, yaw=0.5, vx=50, vy=0, yaw_rate=0, bias_ax=0,
        bias_ay=0, bias_yaw_rate=0, std=(0.1, 0.2, *(0.1,) * 7), steer=0, drive=0, innovations_rejected=0,
    )  # fmt: skip


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")
def test_a_client_is_told_every_topic_and_gets_messages_as_they_come(
    live: FoxgloveLive, bus: LocalBus, tmp_path: Path
) -> None:
    with Browser(tmp_path / "profile") as browser:
        browser.evaluate(CLIENT.replace("PORT", str(live.port)))
        browser.wait_for("Object.keys(window.topics).length > 10")
        topics = browser.evaluate("window.topics")
        assert topics.keys() == {t.key for t in TOPICS if t is not TRUTH} | CHANNELS.keys()
        assert browser.evaluate("window.capabilities") == [], "nothing a client could send"

        def heard(topic: str) -> list[str]:
            return browser.evaluate(f"window.got[{topics[topic][0]}]")

        for now_ns in range(0, 20 * NS_PER_S, NS_PER_S):  # the server takes a moment to note what is subscribed to
            bus.publish(ESTIMATE, estimate(120.0))
            live.step(now_ns, UNIX_NS)
            if all(heard(topic) for topic in (ESTIMATE.key, TRANSFORM, SCENE, LOCATION)):
                break
            time.sleep(0.1)
        stamp, text = heard(ESTIMATE.key)
        assert (int(stamp), m.Estimate.model_validate_json(text)) == (UNIX_NS, estimate(120.0))
        place = json.loads(heard(TRANSFORM)[1])
        assert (place["translation"]["x"], place["timestamp"]) == (120.0, {"sec": 1_700_000_000, "nsec": 123_456_789})
        assert {e["id"] for e in json.loads(heard(SCENE)[1])["entities"]} == {"track", "car"}
        assert json.loads(heard(LOCATION)[1])["latitude"] != 0.0


def test_a_port_that_is_taken_is_one_clear_line(live: FoxgloveLive, bus: LocalBus) -> None:
    config = Config()
    with pytest.raises(InputError, match=rf"cannot listen on 127.0.0.1:{live.port}: .*choose another --port"):
        FoxgloveLive(bus, load_track(config.track), config, "127.0.0.1", live.port)
