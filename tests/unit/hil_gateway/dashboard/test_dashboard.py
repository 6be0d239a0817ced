"""The live page: subscribes only, needs no other server, and shows the loop in a real browser."""

from __future__ import annotations

import json
import re
import socket
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import uvicorn
from support.browser import CHROMIUM, Browser

from hil_gateway.bus import messages as m
from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.topics import ALERT, BELIEF, ESTIMATE, GATEWAY_STATUS, PLAN, TRUTH, Topic
from hil_gateway.dashboard.feed import Feed, track_outline
from hil_gateway.dashboard.server import create_app
from hil_gateway.track.loading import load_track


class ListeningBus(LocalBus):
    """A bus on which publishing by the code under test would be seen."""

    def __init__(self) -> None:
        super().__init__()
        self.subscribed: list[str] = []

    def subscribe(self, topic: Topic[Any], depth: int = 1) -> Any:
        self.subscribed.append(topic.key)
        return super().subscribe(topic, depth)


def publish_scene(bus: LocalBus, now_ns: int) -> None:
    """A car at speed on the road course, with a belief, a plan and an alert."""
    track = load_track()
    x, y, yaw = (float(a[200]) for a in (track.x, track.y, track.heading))
    ahead = slice(200, 300, 5)
    bus.publish(
        ESTIMATE,
        m.Estimate(
            stamp_ns=now_ns, seq=1, state_stamp_ns=now_ns, valid=True, x=x, y=y, yaw=yaw, vx=61.5, vy=0.1, yaw_rate=0.2,
            bias_ax=0, bias_ay=0, bias_yaw_rate=0, std=(0.1,) * 9, steer=0.02, drive=0.01, innovations_rejected=0,
        ),
    )  # fmt: skip
    names = ("cx", "bf", "cf", "df", "br", "cr", "dr")
    mean = (52000.0, 9.4, 1.31, 1.42, 10.6, 1.38, 1.40)
    covariance = tuple(tuple((0.08 * a) ** 2 if i == j else 0.0 for j in range(7)) for i, a in enumerate(mean))
    bus.publish(
        BELIEF,
        m.Belief(
            stamp_ns=now_ns, seq=1, layout="per_axle", names=names, mean=mean, covariance=covariance,
            samples=4321, log_det_information=3.0,
        ),
    )  # fmt: skip
    xs, ys = tuple(map(float, track.x[ahead])), tuple(map(float, track.y[ahead]))
    zeros = (0.0,) * len(xs)
    bus.publish(
        PLAN,
        m.Plan(
            stamp_ns=now_ns, seq=1, state_stamp_ns=now_ns, status=m.PlanStatus.SOLVED, dt=0.05, x=xs, y=ys, yaw=zeros,
            vx=zeros, s=zeros, steer=zeros, drive=zeros, lap=3, revision="abc", solve_ms=12.5,
        ),
    )  # fmt: skip
    bus.publish(
        GATEWAY_STATUS,
        m.GatewayStatus(
            stamp_ns=now_ns, seq=1, mode="armed", armed=True, action=m.FailsafeAction.DRIVE, cause="",
            missing_for_arming=(), bus="socketcan vcan0", bus_state="error_active", frames_received=123456,
            frames_lost=0, frames_unknown=0, frames_malformed=0, counter_errors=0, commands_sent=98765,
            commands_limited=12, loop_latency_p50_ms=21.0, loop_latency_p99_ms=38.0,
        ),
    )  # fmt: skip
    alert = m.Alert(stamp_ns=now_ns, seq=1, channel="ay", condition="right turns above 40 m/s", strength=3.2)
    bus.publish(ALERT, alert)


def test_feed_never_subscribes_to_truth_and_never_publishes() -> None:
    bus = ListeningBus()
    watcher = [bus.subscribe(topic) for topic in (ESTIMATE, GATEWAY_STATUS)]
    bus.subscribed.clear()
    feed = Feed(bus)
    feed.snapshot(0)
    assert TRUTH.key not in bus.subscribed
    assert all(subscription.poll(0) == [] for subscription in watcher)


def test_snapshot_is_finite_json_before_and_after_the_first_messages() -> None:
    bus = LocalBus()
    feed = Feed(bus)
    empty = json.loads(json.dumps(feed.snapshot(10**9), allow_nan=False))
    assert empty["ages"]["estimate"] == {"age_s": None, "alive": False}
    publish_scene(bus, 2 * 10**9)
    full = json.loads(json.dumps(feed.snapshot(2 * 10**9), allow_nan=False))
    assert full["messages"]["belief"]["std"][3] == pytest.approx(0.08 * 1.42)
    assert full["alerts"][0]["channel"] == "ay"
    assert full["ages"]["estimate"]["alive"]


@pytest.fixture
def loop_runs() -> threading.Event:
    """Set while somebody publishes."""
    event = threading.Event()
    event.set()
    return event


@pytest.fixture
def served_page(loop_runs: threading.Event) -> Iterator[str]:
    """URL of a page fed with the scene, ten times a second."""
    bus = LocalBus()
    feed = Feed(bus)

    def snapshot() -> dict[str, Any]:
        now_ns = time.monotonic_ns()
        if loop_runs.is_set():
            publish_scene(bus, now_ns)
        return feed.snapshot(now_ns)

    listener = socket.create_server(("127.0.0.1", 0))
    app = create_app(snapshot, track_outline(load_track()), 0.1)
    server = uvicorn.Server(uvicorn.Config(app, log_level="error", lifespan="off", timeout_graceful_shutdown=1))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
    thread.start()
    yield f"http://127.0.0.1:{listener.getsockname()[1]}/"
    server.should_exit = True
    thread.join(timeout=10)


def test_page_and_its_parts_are_served_and_name_no_other_server(served_page: str) -> None:
    for path in ("", "app.js", "style.css"):
        with urllib.request.urlopen(served_page + path) as response:
            assert "default-src 'none'" in response.headers["content-security-policy"]
            assert not re.search(r"https?://(?!www\.w3\.org)", response.read().decode())
    with urllib.request.urlopen(served_page + "track.json") as response:
        assert len(json.load(response)["left"]["x"]) > 300


def test_page_accepts_nothing_but_reading(served_page: str) -> None:
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(urllib.request.Request(served_page, data=b"x"))
    assert refused.value.code == 405
    refused.value.close()


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: apt-get install chromium")
def test_a_real_browser_shows_car_belief_and_alert_and_does_not_say_drive_when_the_gateway_is_silent(
    served_page: str, loop_runs: threading.Event, tmp_path: Path
) -> None:
    with Browser(tmp_path / "profile") as browser:
        browser.open(served_page)
        browser.wait_for("document.getElementById('speed')?.textContent === '61.5'")
        browser.wait_for("document.getElementById('edges').getAttribute('d') !== null")
        assert browser.evaluate("document.getElementById('action').className") == "pill drive"
        assert "right turns above 40 m/s" in browser.evaluate("document.getElementById('alerts').textContent")
        assert browser.evaluate("document.getElementById('samples').textContent") == "4321 samples"
        assert browser.evaluate("document.querySelectorAll('#belief td.bar svg').length") == 7
        assert browser.evaluate("document.querySelectorAll('#ages td.old').length") > 0
        car = json.loads(browser.evaluate("JSON.stringify(document.getElementById('car').getBoundingClientRect())"))
        chart = json.loads(browser.evaluate("JSON.stringify(document.getElementById('map').getBoundingClientRect())"))
        assert chart["left"] < car["left"] < chart["right"]
        assert chart["top"] < car["top"] < chart["bottom"]
        time.sleep(1.0)
        browser.screenshot(tmp_path / "page.png")
        loop_runs.clear()
        browser.wait_for("document.getElementById('action').textContent === 'no word from the gateway'")
        assert browser.evaluate("document.getElementById('action').className") == "pill"
