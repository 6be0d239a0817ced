"""The live page: subscribes only, needs no other server, and shows the loop in a real browser."""

from __future__ import annotations

import json
import math
import re
import socket
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from support.browser import CHROMIUM, Browser
from support.cars.session_rig import UNIX_NS
from support.serving import served

from hil_gateway.bus import messages as m
from hil_gateway.bus.alerts import grouped
from hil_gateway.bus.event import Event, EventKind, Severity
from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.playback import Playback
from hil_gateway.bus.race_line import RaceLine
from hil_gateway.bus.topics import (
    ALERT,
    BELIEF,
    ESTIMATE,
    EVENT,
    GATEWAY_STATUS,
    PLAN,
    PLAYBACK,
    RACE_LINE,
    TRUTH,
    VEHICLE_STATE,
    Topic,
)
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.config import Config
from hil_gateway.dashboard import server
from hil_gateway.dashboard.feed import Feed
from hil_gateway.dashboard.recording import Recording
from hil_gateway.dashboard.recording import create_app as recording_app
from hil_gateway.dashboard.server import create_app
from hil_gateway.dashboard.setup import setup_of
from hil_gateway.dashboard.tyre_curve import curves
from hil_gateway.session.files.writer import SessionFile
from hil_gateway.track.loading import load_track

UNHEARD = replace(PLAN, key="av24/unheard")


class ListeningBus(LocalBus):
    """A bus on which publishing by the code under test would be seen."""

    def __init__(self) -> None:
        super().__init__()
        self.subscribed: list[str] = []

    def subscribe(self, topic: Topic[Any], depth: int = 1) -> Any:
        self.subscribed.append(topic.key)
        return super().subscribe(topic, depth)


def publish_scene(bus: LocalBus, now_ns: int, *, plan: bool = True) -> None:
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
        PLAN if plan else UNHEARD,
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

    bus.publish(VEHICLE_STATE, vehicle_state(now_ns))
    bus.publish(RACE_LINE, race_line(now_ns, 70.0))


def race_line(now_ns: int, speed: float) -> RaceLine:
    """The centre line, driven at `speed` m/s except at its start."""
    track = load_track()
    x, y, s = (tuple(values[::8].tolist()) for values in (track.x, track.y, track.s))
    return RaceLine(
        stamp_ns=now_ns, seq=1, x=x, y=y, vx=(60.0, *(speed,) * (len(x) - 1)), track_s=s, clearance_m=1.5,
        lap_time_s=83.5,
    )  # fmt: skip


def vehicle_state(now_ns: int, report_age_s: float = 0.005) -> m.VehicleState:
    """A car at speed whose reports are that old."""
    numbers = dict.fromkeys(
        (
            "ax", "ay", "az", "yaw_rate", "roll_rate", "wheel_speed_fl", "wheel_speed_fr", "wheel_speed_rl",
            "wheel_speed_rr", "steer", "steer_rate", "accelerator", "throttle", "brake_front", "brake_rear", "drive",
            "engine_speed", "position_x", "position_y",
        ),
        0.0,
    )  # fmt: skip
    whole = dict.fromkeys(("gear", "position_seq", "sys_state", "ct_state", "track_flag", "vehicle_flag"), 1)
    sources = {"imu": m.SourceHealth(age_s=report_age_s, valid=True)}
    return m.VehicleState(stamp_ns=now_ns, seq=1, valid=True, sources=sources, **numbers, **whole)


def stop_event(now_ns: int, cause: str, after: str = "controlled_stop") -> Event:
    """The gateway has stopped the car."""
    return Event(
        stamp_ns=now_ns, seq=1, kind=EventKind.FAILSAFE, severity=Severity.STOP, before="drive", after=after,
        cause=cause, measured=0.11, limit=0.1, unit="s", text="no fresh planner command",
    )  # fmt: skip


def armed_event(now_ns: int) -> Event:
    """A person has armed the gateway."""
    info = Severity.INFO
    return Event(stamp_ns=now_ns, seq=2, kind=EventKind.ARMING, severity=info, before="silent", after="drive", text="x")


def feed_on(bus: LocalBus) -> Feed:
    return Feed(bus, load_track(), Config())


def test_feed_never_subscribes_to_truth_and_never_publishes() -> None:
    bus = ListeningBus()
    watcher = [bus.subscribe(topic) for topic in (ESTIMATE, GATEWAY_STATUS)]
    bus.subscribed.clear()
    feed = feed_on(bus)
    feed.snapshot(0)
    assert TRUTH.key not in bus.subscribed
    assert all(subscription.poll(0) == [] for subscription in watcher)


def test_snapshot_is_finite_json_before_and_after_the_first_messages() -> None:
    bus = LocalBus()
    feed = feed_on(bus)
    empty = json.loads(json.dumps([feed.snapshot(10**9), feed.slow()], allow_nan=False))
    assert empty[0]["ages"]["estimate"] == {"age_s": None, "alive": False}
    assert empty[0]["state"]["name"] == "WAITING"
    publish_scene(bus, 2 * 10**9)
    full, slow = json.loads(json.dumps([feed.snapshot(2 * 10**9), feed.slow()], allow_nan=False))
    friction = next(row for row in slow["tyres"]["parameters"] if row["symbol"] == "df")
    assert friction["std"] == pytest.approx(0.08 * 1.42) and friction["name"] == "front friction D"
    assert slow["alerts"][0]["channels"] == ["ay"]
    assert full["ages"]["estimate"]["alive"] and full["row"]["speed"] == 61.5


def test_the_race_line_is_named_once_and_its_speed_is_the_one_at_the_car_s_place() -> None:
    bus, track = LocalBus(), load_track()
    feed = feed_on(bus)
    publish_scene(bus, 10**9)
    assert feed.snapshot(10**9)["row"]["line_speed"] == pytest.approx(70.0)
    name = feed.slow()["line"]
    drawn = feed.line(name)
    assert drawn is not None and feed.line("another") is None
    left, inner = setup_of(track, Config())["track"]["left"], drawn["corridor"]["left"]
    assert math.dist((left["x"][7], left["y"][7]), (inner["x"][7], inner["y"][7])) == pytest.approx(1.5, abs=0.02)
    bus.publish(RACE_LINE, race_line(2 * 10**9, 50.0))
    publish_scene(bus, 2 * 10**9)
    feed.snapshot(2 * 10**9)
    assert feed.slow()["line"] == name, "another speed on the same path is not fetched again"


def test_grip_used_is_what_was_measured_over_what_is_believed_to_be_there() -> None:
    bus = LocalBus()
    feed, vehicle = feed_on(bus), Config().vehicle
    publish_scene(bus, 10**9)
    held = 1.40 * (GRAVITY + vehicle.downforce(61.5) / vehicle.mass)
    bus.publish(VEHICLE_STATE, vehicle_state(10**9).model_copy(update={"ax": 0.3 * held, "ay": -0.4 * held}))
    assert feed.snapshot(10**9)["row"]["grip"] == pytest.approx(50.0)
    assert feed.snapshot(9 * 10**9)["row"]["grip"] is None


def test_live_lost_frozen_and_replay_are_told_apart() -> None:
    bus = LocalBus()
    feed, now_ns = feed_on(bus), 10**9
    publish_scene(bus, now_ns)
    assert feed.snapshot(now_ns)["state"]["name"] == "LIVE"
    publish_scene(bus, now_ns)
    bus.publish(VEHICLE_STATE, vehicle_state(now_ns, report_age_s=0.7))
    assert feed.snapshot(now_ns)["state"]["name"] == "FROZEN"
    assert "0.7 s" in feed.snapshot(now_ns)["state"]["why"]
    assert feed.snapshot(now_ns + 10**9)["state"]["name"] == "LOST"
    bus.publish(PLAYBACK, Playback(stamp_ns=0, seq=0, file="a.mcap", position_s=3.0, speed=1.0))
    assert feed.snapshot(now_ns + 10**9)["state"]["name"] == "REPLAY"


def test_what_has_fallen_silent_leaves_a_gap_in_the_history_not_a_flat_line() -> None:
    bus = LocalBus()
    feed = feed_on(bus)
    publish_scene(bus, 10**9)
    feed.snapshot(10**9)
    feed.snapshot(3 * 10**9)
    columns = feed.history()
    assert columns["speed"] == [61.5, None] and columns["plan_ms"] == [12.5, None]


def test_the_page_is_told_how_the_car_stands_on_the_track_and_nothing_of_a_dead_estimator() -> None:
    bus, track, now_ns = LocalBus(), load_track(), 10**9
    feed = Feed(bus, track, Config())
    at = track.at(300.0)
    x, y = at.x - 1.5 * math.sin(at.heading), at.y + 1.5 * math.cos(at.heading)
    bus.publish(ESTIMATE, m.Estimate(
        stamp_ns=now_ns, seq=1, state_stamp_ns=now_ns, valid=False, lacks="heading", x=x, y=y,
        yaw=at.heading + 0.7, vx=0, vy=0, yaw_rate=0, bias_ax=0, bias_ay=0, bias_yaw_rate=0, steer=0, drive=0,
        std=(0.1, 0.1, 0.5, *(0.1,) * 6),
        innovations_rejected=0,
    ))  # fmt: skip
    place = feed.snapshot(now_ns)["place"]
    assert place["lateral_m"] == pytest.approx(1.5, abs=0.02)
    assert place["across_deg"] == pytest.approx(40.1, abs=0.3)
    assert place["heading_std_deg"] == pytest.approx(28.6, abs=0.1)
    assert place["lacks"] == "heading"
    assert feed.snapshot(now_ns + 7 * 10**9)["place"] is None


def test_the_history_is_bounded_and_a_page_that_is_loaded_later_gets_all_of_it() -> None:
    bus = LocalBus()
    feed = Feed(bus, load_track(), Config(), minutes=0.5)
    for i in range(1000):
        feed.snapshot(i * 10**8)
    columns = feed.history()
    assert {len(values) for values in columns.values()} == {300}
    assert columns["t"][-1] == pytest.approx(99.9)


def test_first_and_last_cause_of_a_stop_stay_until_the_next_arming() -> None:
    bus = LocalBus()
    feed = feed_on(bus)
    bus.publish(EVENT, stop_event(1, "command_stale"))
    feed.snapshot(1)
    bus.publish(EVENT, stop_event(2, "command_dead", "emergency_stop"))
    for now_ns in (2, 60 * 10**9):
        feed.snapshot(now_ns)
        stop = feed.slow()["stop"]
        assert (stop["first"]["cause"], stop["last"]["cause"]) == ("command_stale", "command_dead")
    bus.publish(EVENT, armed_event(3))
    feed.snapshot(61 * 10**9)
    assert feed.slow()["stop"] == {"first": None, "last": None}


def test_alerts_of_one_suspected_effect_are_one_line() -> None:
    alerts = [
        (t, m.Alert(stamp_ns=0, seq=0, channel=channel, condition=f"case {t}", suspected_effect=effect, strength=t))
        for t, channel, effect in ((1.0, "ax", "aero_drag"), (2.0, "ay", "aero_drag"), (3.0, "ay", ""))
    ]
    unexplained, drag = grouped(alerts)
    assert (unexplained["suspect"], unexplained["channels"]) == ("", ["ay"])
    assert (drag["channels"], drag["strength"], drag["first"], drag["last"]) == (["ax", "ay"], 2.0, 1.0, 2.0)


def test_a_suspect_that_a_later_one_has_replaced_is_not_shown_any_more() -> None:
    suspects = ("rolling_resistance", "wind", "aero_drag")
    alerts = [
        (float(t), m.Alert(stamp_ns=0, seq=0, channel="ax", condition="c", suspected_effect=effect, strength=4))
        for t, effect in enumerate(suspects)
    ]
    assert [line["suspect"] for line in grouped(alerts)] == ["aero_drag"]


def test_the_tyre_curve_is_the_one_of_the_estimator_s_model_and_its_band_that_of_sampling() -> None:
    import numpy as np

    from estimator.model.tyre import lateral_force

    rng, mean = np.random.default_rng(1), np.array((52000.0, 9.4, 1.31, 1.42, 10.6, 1.38, 1.40))
    covariance = np.diag((0.01 * mean) ** 2)
    names = ("cx", "bf", "cf", "df", "br", "cr", "dr")
    belief = m.Belief(
        stamp_ns=1, seq=1, layout="per_axle", names=names, mean=tuple(mean.tolist()),
        covariance=tuple(map(tuple, covariance.tolist())), samples=1, log_det_information=0.0,
    )  # fmt: skip
    drawn = curves(belief)
    slip = np.radians(drawn["slip_deg"])
    samples = rng.multivariate_normal(mean[1:4], covariance[1:4, 1:4], 4000)
    forces = np.array([[float(lateral_force(a, 1.0, b, c, d)) for a in slip] for b, c, d in samples[:400]])
    expected = [float(lateral_force(a, 1.0, *mean[1:4])) for a in slip]
    assert drawn["front"]["mean"] == pytest.approx(expected, abs=1e-3)
    assert np.allclose(drawn["front"]["std"], forces.std(axis=0), rtol=0.2, atol=2e-3)


@pytest.fixture
def loop_runs() -> threading.Event:
    """Set while somebody publishes."""
    event = threading.Event()
    event.set()
    return event


class Loop:
    """The scene, published whenever a page asks, as long as somebody drives."""

    def __init__(self, loop_runs: threading.Event) -> None:
        self.bus, self.runs = LocalBus(), loop_runs
        self.planner_runs = True
        self.feed = feed_on(self.bus)
        self.slow, self.history, self.line = self.feed.slow, self.feed.history, self.feed.line

    def snapshot(self) -> dict[str, Any]:
        now_ns = time.monotonic_ns()
        if self.runs.is_set():
            publish_scene(self.bus, now_ns, plan=self.planner_runs)
        return self.feed.snapshot(now_ns)


@pytest.fixture
def loop(loop_runs: threading.Event) -> Loop:
    return Loop(loop_runs)


@pytest.fixture
def served_page(loop: Loop) -> Iterator[str]:
    """URL of a live page, fed ten times a second."""
    with served(create_app(loop, setup_of(load_track(), Config(), limit_s=80.0), 0.1)) as url:
        yield url


def test_page_and_its_parts_are_served_and_name_no_other_server(served_page: str) -> None:
    for path in ("", "app.js", "charts.js", "style.css", "uplot/uPlot.iife.min.js", "uplot/LICENSE"):
        with urllib.request.urlopen(served_page + path) as response:
            assert "default-src 'none'" in response.headers["content-security-policy"]
            text = response.read().decode()
            assert not re.search(r"""(src|href|fetch\()\s*=?\s*["']https?://""", text)
    with urllib.request.urlopen(served_page + "setup.json") as response:
        setup = json.load(response)
    assert len(setup["track"]["left"]["x"]) > 300
    assert setup["limits"]["steer_deg"] == pytest.approx(math.degrees(0.279), abs=0.01)


def test_page_accepts_nothing_but_reading(served_page: str) -> None:
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(urllib.request.Request(served_page, data=b"x"))
    assert refused.value.code == 405
    refused.value.close()


def test_who_only_connects_takes_neither_the_page_from_others_nor_the_log(
    served_page: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(server, "ASKS_WITHIN_S", 0.5)
    host, port = served_page.removeprefix("http://").strip("/").split(":")
    crowd = [socket.create_connection((host, int(port))) for _ in range(server.MOST + 50)]
    for one in crowd:
        with suppress(OSError):  # those beyond the bound are refused
            one.sendall(b"GET / HT")
    deadline_s = time.monotonic() + 30.0
    while not _reads(served_page):
        assert time.monotonic() < deadline_s
    for one in crowd:
        one.close()
    for _ in range(3):
        with socket.create_connection((host, int(port))) as one:
            one.sendall(b"\0\0\r\n\r\n")
            assert b"400" in one.recv(100)
    assert capfd.readouterr().err == ""


def _reads(url: str) -> bool:
    try:
        with urllib.request.urlopen(url, timeout=1.0) as response:
            return bool(response.read())
    except OSError:
        return False


needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: apt-get install chromium")
TEXT = "document.getElementById('{}').textContent"


@needs_browser
def test_a_real_browser_shows_car_belief_and_alert_and_never_passes_old_figures_for_live_ones(
    served_page: str, loop: Loop, loop_runs: threading.Event, tmp_path: Path
) -> None:
    with Browser(tmp_path / "profile") as browser:
        browser.open(served_page)
        browser.wait_for("document.getElementById('speed')?.textContent === '221'")
        browser.wait_for("document.getElementById('edges').getAttribute('d') !== null")
        assert browser.evaluate(TEXT.format("state")) == "LIVE"
        assert browser.evaluate("document.getElementById('action').className") == "pill drive"
        browser.wait_for("document.getElementById('alerts').textContent.includes('right turns above 40 m/s')")
        assert browser.evaluate("document.querySelectorAll('#belief td.bar svg').length") == 7
        assert "front friction D" in browser.evaluate(TEXT.format("belief"))
        car = json.loads(browser.evaluate("JSON.stringify(document.getElementById('car').getBoundingClientRect())"))
        chart = json.loads(browser.evaluate("JSON.stringify(document.getElementById('map').getBoundingClientRect())"))
        assert chart["left"] < car["left"] < chart["right"]
        assert chart["top"] < car["top"] < chart["bottom"]
        browser.wait_for("document.getElementById('plan').getAttribute('points') !== ''")
        browser.wait_for("document.getElementById('raceline').getAttribute('d')?.length > 1000")
        assert browser.evaluate("document.getElementById('overlimit').hidden") is False
        assert browser.evaluate(TEXT.format("linetime")) == "1:23.50"
        loop.planner_runs = False
        browser.wait_for("document.getElementById('plan').getAttribute('points') === ''")
        assert "the planner is silent" in browser.evaluate(TEXT.format("status"))
        loop_runs.clear()
        browser.wait_for("document.getElementById('state').textContent === 'LOST'")
        assert browser.evaluate("document.getElementById('action').className") == "pill"
        assert browser.evaluate("document.getElementById('speed').parentElement.className").strip() == "stale"
        assert [browser.evaluate(TEXT.format(name)) for name in ("speed", "across", "lateral")] == ["–"] * 3


@needs_browser
def test_a_stop_is_announced_with_first_and_last_cause_and_a_reload_loses_nothing(
    served_page: str, loop: Loop, tmp_path: Path
) -> None:
    now_ns = time.monotonic_ns()
    with Browser(tmp_path / "profile") as browser:
        browser.open(served_page)
        browser.wait_for("document.getElementById('state').textContent === 'LIVE'")
        assert browser.evaluate("document.getElementById('stop').hidden")
        loop.bus.publish(EVENT, stop_event(now_ns, "command_stale"))
        loop.bus.publish(EVENT, stop_event(now_ns + 1, "command_dead", "emergency_stop"))
        browser.wait_for("!document.getElementById('stop').hidden")
        assert browser.evaluate("document.getElementById('stop').getAttribute('aria-live')") == "assertive"
        said = browser.evaluate(TEXT.format("stop"))
        assert "command stale" in said and "command dead" in said and "limit 0.1 s" in said
        points = "document.querySelectorAll('.u-series').length"
        browser.open(served_page)
        browser.wait_for("document.getElementById('stop')?.hidden === false")
        browser.wait_for(f"{points} > 7")
        with urllib.request.urlopen(served_page + "history.json") as response:
            assert len(json.load(response)["t"]) > 5


@needs_browser
def test_every_text_stands_out_from_its_ground_by_4_5_to_1_and_nothing_scrolls_sideways(
    served_page: str, tmp_path: Path
) -> None:
    with Browser(tmp_path / "profile") as browser:
        for size in ((390, 844), (1024, 768), (1600, 1000), (2560, 1440)):
            browser.resize(*size)
            browser.open(served_page)
            browser.wait_for("document.querySelectorAll('#belief td').length > 7")
            themes = []
            for _ in range(2):
                themes.append(browser.evaluate("document.documentElement.dataset.theme"))
                assert browser.evaluate("document.documentElement.scrollWidth <= innerWidth"), (size, themes)
                assert json.loads(browser.evaluate(CONTRAST)) == [], (size, themes)
                browser.evaluate("document.getElementById('theme').click()")
            assert sorted(themes) == ["dark", "light"]


CONTRAST = """(() => {
  const parse = (c) => c.match(/[\\d.]+/g).map(Number);
  const part = (v) => { v /= 255; return v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4; };
  const light = ([r, g, b]) => 0.2126 * part(r) + 0.7152 * part(g) + 0.0722 * part(b);
  const ground = (node) => {
    for (let n = node; n; n = n.parentElement) {
      const c = parse(getComputedStyle(n).backgroundColor);
      if (c.length < 4 || c[3] > 0) return c;
    }
    return [255, 255, 255];
  };
  const low = [];
  for (const node of document.querySelectorAll("body *")) {
    const own = [...node.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim());
    if (!own || !node.getClientRects().length || node.closest("svg")) continue;
    const [a, b] = [light(parse(getComputedStyle(node).color)), light(ground(node))].sort((x, y) => y - x);
    const ratio = (a + 0.05) / (b + 0.05);
    if (ratio < 4.5) low.push(`${node.tagName} ${node.className} ${node.textContent.slice(0, 20)} ${ratio.toFixed(2)}`);
  }
  return JSON.stringify(low);
})()"""


@pytest.fixture
def recording(tmp_path: Path) -> Recording:
    """Five seconds of the scene, with a stop at 3 s, as the recorder would have written it."""
    path, bus = tmp_path / "drive.mcap", LocalBus()
    topics = (ESTIMATE, BELIEF, PLAN, GATEWAY_STATUS, VEHICLE_STATE, EVENT)
    queues = {topic: bus.subscribe(topic, depth=8) for topic in topics}
    with SessionFile(path, {"session": {"name": "drive"}}) as file:
        for tenth in range(50):
            now_ns = (100 + tenth) * 10**8
            publish_scene(bus, now_ns)
            if tenth == 30:
                bus.publish(EVENT, stop_event(now_ns, "command_stale"))
            for topic, queue in queues.items():
                for message in queue.poll(now_ns):
                    data = message.model_dump_json().encode()
                    file.add(topic.key, data, UNIX_NS + now_ns, UNIX_NS + now_ns, tenth)
    return Recording(path, load_track(), Config())


def test_a_recording_shows_at_every_moment_what_was_known_then(recording: Recording) -> None:
    start = recording.times[0]
    before, after = (json.loads(recording.at(start + t)) for t in (1.0, 4.5))
    assert before["slow"]["stop"]["first"] is None
    assert after["slow"]["stop"]["first"]["cause"] == "command_stale"
    assert before["quick"]["row"]["speed"] == 61.5
    assert json.loads(recording.at(-1e9))["quick"]["t"] == recording.times[0]
    assert recording.times[-1] - start == pytest.approx(4.8, abs=0.11)


@needs_browser
def test_a_recording_is_said_to_be_one_and_is_moved_in_by_the_bar(recording: Recording, tmp_path: Path) -> None:
    app = recording_app(recording, load_track(), Config())
    with served(app) as url, Browser(tmp_path / "profile") as browser:
        browser.open(f"{url}?t=1")
        browser.wait_for("document.getElementById('state').textContent === 'REPLAY'")
        assert browser.evaluate("document.getElementById('stop').hidden")
        move = "const s = document.getElementById('scrub'); s.value = 4.5; s.dispatchEvent(new Event('input'));"
        browser.evaluate(f"{{ {move} }}")
        browser.wait_for("document.getElementById('stop').hidden === false")
        assert browser.evaluate(TEXT.format("clock")).startswith("4.5 s of")


@pytest.mark.parametrize("names", [("cx",), ("cx", "b", "c", "d"), ("a", "b")])
def test_a_belief_of_other_parameters_leaves_the_page_alive(names: tuple[str, ...]) -> None:
    """Another estimator, or anybody: as many names as it likes, values of nought."""
    bus = LocalBus()
    feed = Feed(bus, load_track(), Config())
    publish_scene(bus, 10**9)
    feed.snapshot(10**9)
    assert len(feed.slow()["tyres"]["parameters"]) == 7
    zeros = (0.0,) * len(names)
    belief = m.Belief(
        stamp_ns=2 * 10**9, seq=2, layout="shared", names=names, mean=zeros, covariance=(zeros,) * len(names),
        samples=1, log_det_information=0.0,
    )  # fmt: skip
    bus.publish(BELIEF, belief)
    feed.snapshot(2 * 10**9)
    tyres = feed.slow()["tyres"]
    assert [row["symbol"] for row in tyres["parameters"]] == list(names)
    json.dumps(tyres, allow_nan=False)
