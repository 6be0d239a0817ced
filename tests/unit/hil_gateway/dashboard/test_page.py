"""The live page needs no other server, accepts nothing, and shows the loop in a real browser."""

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
from pathlib import Path
from typing import Any

import pytest
from support.browser import TEXT, Browser, needs_browser
from support.scene import (
    feed_on,
    publish_scene,
    stop_event,
)
from support.serving import served

from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.topics import (
    EVENT,
)
from hil_gateway.config import Config
from hil_gateway.dashboard import server
from hil_gateway.dashboard.server import create_app
from hil_gateway.dashboard.setup import setup_of
from hil_gateway.track.loading import load_track


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
        browser.evaluate("import('./format.js').then((m) => { window.gaps = [125.26, -0.5].map(m.lapGap).join() })")
        browser.wait_for("window.gaps === '+2:05.26,−0.50 s'")  # a gap as wide as a lap is written as one
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
