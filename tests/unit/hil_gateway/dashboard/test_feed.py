"""What the live page is sent: subscribed only, finite, and what has fallen silent is no figure."""

from __future__ import annotations

import json
import math

import pytest
from support.scene import (
    ListeningBus,
    armed_event,
    feed_on,
    publish_scene,
    race_line,
    stop_event,
    vehicle_state,
)

from hil_gateway.bus import messages as m
from hil_gateway.bus.alerts import grouped
from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.playback import Playback
from hil_gateway.bus.topics import (
    ESTIMATE,
    EVENT,
    GATEWAY_STATUS,
    PLAYBACK,
    RACE_LINE,
    TRUTH,
    VEHICLE_STATE,
)
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.config import Config
from hil_gateway.dashboard.feed import Feed
from hil_gateway.dashboard.setup import setup_of
from hil_gateway.dashboard.tyre_curve import curves
from hil_gateway.track.loading import load_track


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
