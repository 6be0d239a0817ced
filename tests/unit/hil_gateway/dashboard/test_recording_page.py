"""The page of a recording shows at every moment what was known then."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.browser import TEXT, Browser, needs_browser
from support.cars.session_rig import UNIX_NS
from support.scene import (
    publish_scene,
    stop_event,
)
from support.serving import served

from hil_gateway.bus import messages as m
from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.topics import (
    BELIEF,
    ESTIMATE,
    EVENT,
    GATEWAY_STATUS,
    PLAN,
    VEHICLE_STATE,
)
from hil_gateway.config import Config
from hil_gateway.dashboard.feed import Feed
from hil_gateway.dashboard.recording import Recording
from hil_gateway.dashboard.recording import create_app as recording_app
from hil_gateway.session.files.writer import SessionFile
from hil_gateway.track.loading import load_track


@pytest.fixture
def recording(tmp_path: Path) -> Recording:
    """Five seconds of the scene, with a stop at 3 s."""
    return written(tmp_path / "drive.mcap")


def written(path: Path, estimator_until_s: float = 5.0, gateway_until_s: float = 5.0) -> Recording:
    """Five seconds of the scene, as the recorder would have written it."""
    bus = LocalBus()
    until_s = {ESTIMATE: estimator_until_s, GATEWAY_STATUS: gateway_until_s}
    topics = (ESTIMATE, BELIEF, PLAN, GATEWAY_STATUS, VEHICLE_STATE, EVENT)
    queues = {topic: bus.subscribe(topic, depth=8) for topic in topics}
    with SessionFile(path, {"session": {"name": "drive"}}) as file:
        for tenth in range(50):
            now_ns = (100 + tenth) * 10**8
            publish_scene(bus, now_ns)
            if tenth == 30:
                bus.publish(EVENT, stop_event(now_ns, "command_stale"))
            for topic, queue in queues.items():
                for message in queue.poll(now_ns) if tenth < 10 * until_s.get(topic, 5.0) else ():
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
def test_a_recording_opens_where_most_was_known_and_advises_nothing(tmp_path: Path) -> None:
    """Processes end one after the other; nobody can start an estimator of yesterday."""
    recording = written(tmp_path / "drive.mcap", estimator_until_s=2.0, gateway_until_s=3.0)
    app = recording_app(recording, load_track(), Config())
    with served(app) as url, Browser(tmp_path / "profile") as browser:
        browser.open(url)
        browser.wait_for("document.body.innerText.includes('221')")  # the clock is there before the figures are
        shown_s = float(browser.evaluate(TEXT.format("clock")).split()[0])
        assert 1.8 <= shown_s <= 1.9 + ESTIMATE.deadline_s
        browser.open(f"{url}?t=2.8")
        browser.wait_for("document.getElementById('why').textContent.includes('no estimate')")
        assert "hil " not in browser.evaluate(TEXT.format("why"))


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
