"""Parts of the demo that need no processes: what users can get wrong, arming, judging, drawing."""

from __future__ import annotations

import contextlib
import io
import json
import socket
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from support.cars.car_messages import estimate

from hil_gateway.bus import messages as m
from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.topics import ESTIMATE, GATEWAY_STATUS, OPERATOR, PLAN, TRUTH
from hil_gateway.config import Config, load_config
from hil_gateway.demo import drive as demo
from hil_gateway.demo.canvas import Canvas
from hil_gateway.demo.drive import unknown
from hil_gateway.demo.monitor import REASONS_MAX, Monitor, PlanCount
from hil_gateway.demo.operator import Operator
from hil_gateway.demo.options import DemoOptions, parse_effects, prepare
from hil_gateway.demo.referee import DriveReferee
from hil_gateway.demo.run import Ending, RunResult
from hil_gateway.demo.summary import describe, summarise
from hil_gateway.demo.view import LiveView, Scene, line
from hil_gateway.process.errors import InputError
from hil_gateway.track.loading import load_track

MS = 1_000_000


def status(action: str = "silent", missing: tuple[str, ...] = (), cause: str = "", seq: int = 0) -> m.GatewayStatus:
    return m.GatewayStatus(
        stamp_ns=0, seq=seq, mode="armed", armed=action != "silent", action=m.FailsafeAction(action), cause=cause,
        missing_for_arming=missing, bus="wire", bus_state="error_active", frames_received=1, frames_lost=0,
        frames_unknown=0, frames_malformed=0, counter_errors=0, commands_sent=1, commands_limited=0,
        loop_latency_p50_ms=None, loop_latency_p99_ms=None,
    )  # fmt: skip


def truth(x: float, vx: float = 10.0, laps: tuple[float, ...] = (), off: int = 0, seq: int = 0) -> m.Truth:
    return m.Truth(
        stamp_ns=0, seq=seq, x=x, y=0, z=0, yaw=0, vx=vx, vy=0, yaw_rate=0, s=x, lateral_offset=0, off_track=False,
        lap=len(laps), lap_times_s=laps, off_track_count=off,
    )  # fmt: skip


def plan(state: m.PlanStatus, reason: str = "") -> m.Plan:
    one = (0.0,)
    return m.Plan(
        stamp_ns=0, seq=0, state_stamp_ns=0, status=state, reason=reason, dt=0.05, x=one, y=one, yaw=one, vx=one,
        s=one, steer=one, drive=one, lap=0, revision="r", solve_ms=5.0,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"laps": 0}, "--laps 0: at least 1"),
        ({"seconds": -1.0}, "--seconds -1.0: must be positive"),
        ({"seconds": float("nan")}, "--seconds nan"),
        ({"effects": ("aero_drag",)}, "expected NAME=SIZE"),
        ({"effects": ("aero_drag=lots",)}, "expected NAME=SIZE"),
        ({"effects": ("moon_gravity=1",)}, "moon_gravity.*unknown"),
        ({"track": "nowhere.csv"}, "nowhere.csv: no such track file"),
        ({"channel": "can77"}, "can77"),
        ({"config_file": Path("absent.toml")}, "absent.toml: cannot read"),
        ({"zenoh_port": 70000}, "--zenoh-port 70000"),
        ({"out": Path("/proc/nothing/here")}, "cannot write there"),
    ],
)
def test_what_a_user_gets_wrong_is_one_clear_line(tmp_path: Path, options: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words) as raised:
        prepare(DemoOptions(**{"out": tmp_path / "out", **options}))
    assert "\n" not in str(raised.value)


def test_broken_track_and_unknown_key_are_named(tmp_path: Path) -> None:
    track, config = tmp_path / "t.csv", tmp_path / "c.toml"
    track.write_text("x_m,y_m,w_tr_right_m,w_tr_left_m\n0,0,5,5\n1,zero,5,5\n")
    with pytest.raises(InputError, match=r"t\.csv"):
        prepare(DemoOptions(track=str(track), out=tmp_path))
    config.write_text("[planner]\nhorizont = 3\n")
    with pytest.raises(InputError, match=r"unknown key planner\.horizont"):
        prepare(DemoOptions(config_file=config, out=tmp_path))


def test_busy_port_is_named(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(InputError, match="in use"):
        prepare(DemoOptions(zenoh_port=taken.getsockname()[1], out=tmp_path))


def test_a_page_whose_port_is_taken_gets_a_free_one_unless_it_was_asked_for(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        config = tmp_path / "c.toml"
        config.write_text(f"[dashboard]\nport = {port}\n")
        with pytest.raises(InputError, match=rf"dashboard: 127.0.0.1:{port} .*in use; set dashboard.host and") as said:
            prepare(DemoOptions(out=tmp_path / "a", config_file=config, dashboard=True))
        assert "--port" not in str(said.value), "the demo has no such flag"
    with contextlib.ExitStack() as both:
        if _free(Config().dashboard.port):  # else another page holds it, which serves as well
            both.enter_context(socket.create_server(("127.0.0.1", Config().dashboard.port)))
        setup = prepare(DemoOptions(out=tmp_path / "b", dashboard=True))
        setup.lock.release()
    assert setup.config.dashboard.port != Config().dashboard.port


def _free(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) != 0


def test_a_file_that_is_no_model_revision_is_refused_before_anything_starts(tmp_path: Path) -> None:
    broken = tmp_path / "model.json"
    broken.write_bytes(b"\x89MCAP0\r\n")
    with pytest.raises(InputError, match=r"model.json: not a text file"):
        prepare(DemoOptions(model=str(broken), out=tmp_path / "out"))
    broken.write_text('{"revision": 1}')
    with pytest.raises(InputError, match="not a model revision: stamp_ns: Field required"):
        prepare(DemoOptions(model=str(broken), out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_prepared_configuration_reaches_the_processes_unchanged(tmp_path: Path) -> None:
    setup = prepare(DemoOptions(out=tmp_path, effects=("aero_drag=0.7", "wind=3")))
    setup.lock.release()
    assert load_config(setup.config_file) == setup.config
    assert setup.config.plant.effects == {"aero_drag": 0.7, "wind": 3.0}
    assert setup.config.plant.base == "paper", "the effects are all that the declared model lacks"
    assert setup.config.zenoh.connect != Config().zenoh.connect


def test_receivers_are_read_where_the_simulated_ones_are_served_and_can_has_no_position(tmp_path: Path) -> None:
    setup = prepare(DemoOptions(out=tmp_path, receivers=True))
    config = setup.config
    setup.lock.release()
    assert list(config.receivers) == list(config.car.network_receivers)
    assert len({given.address for given in config.receivers.values()}) == len(config.receivers) > 1
    assert (config.plant.receivers, config.plant.can_positions) == (True, False)


def test_the_car_stays_the_one_that_was_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "car.toml"
    path.write_text('[plant]\nbase = "av24"\n')
    options = DemoOptions(out=tmp_path / "out", effects=("aero_drag=0.7",), config_file=path)
    for asked in (options, DemoOptions(out=tmp_path / "plain")):
        setup = prepare(asked)
        setup.lock.release()
        assert setup.config.plant.base == "av24"


def test_the_written_configuration_reads_back_the_same(tmp_path: Path) -> None:
    setup = prepare(DemoOptions(out=tmp_path / "out", effects=("wind=-3.5",)))
    setup.lock.release()
    assert load_config(setup.config_file) == setup.config
    assert setup.config.plant.effects == {"wind": -3.5}


def test_effects_are_read() -> None:
    assert parse_effects(["aero_drag=0.6", "wind = -2"]) == {"aero_drag": 0.6, "wind": -2.0}


def test_operator_cranks_when_that_is_awaited_and_never_again_after_a_stop() -> None:
    bus = LocalBus()
    sent, operator = bus.subscribe(OPERATOR, depth=10), Operator(bus)
    awaited = status(missing=("car_not_driving",)).model_copy(update={"missing_for_crank": ()})
    operator.update(status(missing=("car_not_driving",)), 0)
    assert sent.poll(0) == []
    operator.update(awaited, 1 * MS)
    operator.update(awaited, 2 * MS)
    assert [c.action for c in sent.poll(0)] == [m.OperatorAction.CRANK]
    operator.update(status("drive"), 2700 * MS)
    operator.update(awaited, 9000 * MS)
    assert sent.poll(0) == []


def test_operator_arms_only_when_nothing_is_missing_and_never_again_after_a_stop() -> None:
    bus = LocalBus()
    sent, operator = bus.subscribe(OPERATOR, depth=10), Operator(bus)
    operator.update(None, 0)
    operator.update(status(missing=("plan",)), 0)
    assert sent.poll(0) == []
    operator.update(status(), 1 * MS)
    operator.update(status(), 900 * MS)
    operator.update(status(missing=("command_stale",)), 950 * MS)
    operator.update(status(), 1000 * MS)
    operator.update(status(), 1900 * MS)
    assert sent.poll(0) == [], "the first plans are still on their way: no steady second yet"
    operator.update(status(), 2000 * MS)
    operator.update(status(), 2001 * MS)
    assert [c.action for c in sent.poll(0)] == [m.OperatorAction.ARM]
    operator.update(status(), 2600 * MS)
    assert len(sent.poll(0)) == 1
    operator.update(status("drive"), 2700 * MS)
    operator.update(status("silent"), 9000 * MS)
    assert sent.poll(0) == []


def test_referee_adds_up_distance_laps_and_excursions() -> None:
    bus = LocalBus()
    referee = DriveReferee(bus)
    for x, vx, laps, off in ((0, 5, (), 0), (3, 45, (), 1), (7, 9, (88.5,), 2)):
        bus.publish(TRUTH, truth(x, vx, laps, off))
    referee.update(0)
    assert (referee.distance_m, referee.peak_speed, referee.laps, referee.off_track) == (7.0, 45, 1, 2)
    assert not referee.standing


def test_monitor_notes_stops_once_with_their_cause_and_counts_plans_that_are_not_fresh() -> None:
    bus = LocalBus()
    monitor = Monitor(bus)
    bus.publish(PLAN, plan(m.PlanStatus.STOP, "starting"))
    monitor.update(0, driving=False)
    for t, (action, cause) in enumerate(
        [
            ("drive", ""),
            ("controlled_stop", "plan older than 100 ms"),
            ("controlled_stop", "x"),
            ("emergency_stop", "y"),
        ]
    ):
        bus.publish(GATEWAY_STATUS, status(action, cause=cause, seq=t))
        if t == 0:
            bus.publish(PLAN, plan(m.PlanStatus.SOLVED))
            bus.publish(PLAN, plan(m.PlanStatus.SHIFTED, "deadline"))
        monitor.update(t * 1000 * MS, driving=True)
    assert [(f.t_s, f.action, f.cause) for f in monitor.failsafes] == [
        (1.0, "controlled_stop", "plan older than 100 ms"),
        (3.0, "emergency_stop", "y"),
    ]
    assert (len(monitor.plans.solve_ms), monitor.plans.failures, monitor.plans.reasons) == (2, 1, {"deadline": 1})


def test_plain_line_says_why_nothing_moves_and_what_the_car_does() -> None:
    bus = LocalBus()
    monitor, referee = Monitor(bus), DriveReferee(bus)
    scene = Scene(0, 1.5, monitor, referee, {}, {}, "track on bus")
    assert "waiting for the gateway" in line(scene)
    bus.publish(GATEWAY_STATUS, status(missing=("plan", "estimate")))
    bus.publish(TRUTH, truth(12.0))
    monitor.update(0, driving=False)
    referee.update(0)
    assert "not armed yet: plan (and 1 more)" in line(scene)
    assert "off track 0" in line(scene)
    bus.publish(GATEWAY_STATUS, status())
    monitor.update(0, driving=False)
    assert "ready: `hil gateway arm`" in line(scene)


def test_plain_line_says_what_a_stopped_car_waits_for_and_no_speed_of_an_estimate_that_is_gone() -> None:
    bus = LocalBus()
    monitor = Monitor(bus)
    bus.publish(GATEWAY_STATUS, status("emergency_stop", ("estimate_invalid",), "command_dead"))
    bus.publish(ESTIMATE, estimate(0, vx=40.0))
    monitor.update(0, driving=True)
    now = line(Scene(0, 1.5, monitor, DriveReferee(bus), {}, {"gateway": 1}, "track on bus"))
    assert "40.0 m/s" in now and "before it drives again: no valid estimate: `hil estimator run`" in now
    bus.publish(GATEWAY_STATUS, status("emergency_stop", ("estimate_invalid",), "command_dead", seq=1))
    monitor.update(1000 * MS, driving=True)
    assert "m/s" not in line(Scene(1000 * MS, 1.5, monitor, DriveReferee(bus), {}, {"gateway": 1}, "track on bus"))


@pytest.mark.parametrize(("running", "said"), [({}, ": `hil estimator run`"), ({"estimator": 7}, "")])
def test_what_runs_already_is_not_to_be_started(running: dict[str, int], said: str) -> None:
    """The estimator of a demo is on its way for some seconds."""
    bus = LocalBus()
    monitor = Monitor(bus)
    bus.publish(GATEWAY_STATUS, status(missing=("estimate_invalid",)))
    monitor.update(0, driving=False)
    shown = line(Scene(0, 1.5, monitor, DriveReferee(bus), {}, running, "track on bus"))
    assert shown.endswith(f"not armed yet: no valid estimate{said}")


def test_nothing_is_asked_for_once_the_gateway_is_ending() -> None:
    bus = LocalBus()
    monitor = Monitor(bus)
    bus.publish(GATEWAY_STATUS, status("controlled_stop", ("gateway_ending",), "gateway_ending"))
    monitor.update(0, driving=True)
    scene = Scene(0, 1.5, monitor, DriveReferee(bus), {}, {"gateway": 1}, "track on bus", ending=True)
    console = Console(width=150, height=40, file=io.StringIO(), record=True)
    view = LiveView(load_track("oval"), console)
    view.close()
    console.print(view.page(scene))
    for shown in (line(scene), console.export_text()):
        assert "gateway_ending" in shown and "before it drives again" not in shown


def test_without_a_lap_nobody_waits_for_the_limit_of_one(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Half a minute for a new car."""
    bus = LocalBus()
    monkeypatch.setattr(demo, "_run", lambda options, setup: RunResult(Monitor(bus), DriveReferee(bus)))
    monkeypatch.setattr(demo, "measure", lambda session: unknown("nothing was recorded"))
    monkeypatch.setattr(demo, "lap_limit", lambda parameters, track: pytest.fail("computed"))
    assert demo.drive(DemoOptions(out=tmp_path))["limit_s"] is None


def test_who_speaks_of_the_loop_is_known() -> None:
    bus = LocalBus()
    monitor = Monitor(bus)
    bus.publish(GATEWAY_STATUS, status())
    bus.publish(ESTIMATE, estimate(0))
    bus.publish(PLAN, plan(m.PlanStatus.SOLVED))
    monitor.update(0, driving=False)
    assert monitor.speaking(0) == {"gateway", "estimator", "planner"}
    assert monitor.speaking(300 * MS) == {"gateway"}


@pytest.mark.parametrize(
    ("alive", "said"), [({}, "the gateway has ended"), ({"gateway": 1}, "no word of the gateway for 3.0 s")]
)
def test_nothing_is_shown_of_the_car_once_the_gateway_is_silent(alive: dict[str, int], said: str) -> None:
    bus = LocalBus()
    monitor, referee = Monitor(bus), DriveReferee(bus)
    bus.publish(GATEWAY_STATUS, status("drive"))
    bus.publish(ESTIMATE, estimate(0, vx=27.6))
    monitor.update(0, driving=True)
    console = Console(width=150, height=40, file=io.StringIO(), record=True)
    view = LiveView(load_track("oval"), console)
    view.close()

    def shown(now_ns: int) -> tuple[str, str]:
        scene = Scene(now_ns, 1.0, monitor, referee, {}, alive, "oval on vcan0")
        console.print(view.page(scene))
        return line(scene), console.export_text()

    assert all("drive" in text.lower() and "27.6" in text for text in shown(5 * MS))
    assert all(said in text and "drive  " not in text.lower() and "27.6" not in text for text in shown(3000 * MS))


@pytest.mark.parametrize(("columns", "rows", "wide"), [(150, 40, True), (80, 24, False)])
def test_live_page_fits_the_terminal_and_shows_car_cause_and_ages(columns: int, rows: int, wide: bool) -> None:
    bus = LocalBus()
    monitor, referee = Monitor(bus), DriveReferee(bus)
    bus.publish(GATEWAY_STATUS, status("controlled_stop", cause="plan older than 100 ms"))
    bus.publish(TRUTH, truth(12.0, laps=(88.5,)))
    monitor.update(0, driving=True)
    referee.update(0)
    console = Console(width=columns, height=rows, file=io.StringIO(), record=True)
    view = LiveView(load_track("oval"), console)
    view.close()
    scene = Scene(5 * MS, 1.0, monitor, referee, {"plant": 0.1}, {}, "oval on vcan0")
    console.export_text()
    console.print(view.page(scene))
    text = console.export_text()
    assert "CONTROLLED_STOP" in text
    assert "plan older than 100 ms" in text
    assert "88.50 s" in text
    assert text.count("●") == 1
    assert ("ended" in text) == wide
    for topic in ("gateway", "estimate", "belief", "model", "command"):
        assert topic in text, f"the age of {topic} is cut off"
    assert len(text.splitlines()) <= rows
    assert max(map(len, text.splitlines())) <= columns


def test_map_is_drawn_to_scale_with_the_car_inside() -> None:
    canvas = Canvas([0.0, 100.0, 100.0, 0.0], [0.0, 0.0, 50.0, 50.0], 20, 10)
    lines = canvas.lines()
    assert [len(text) for text in lines] == [20] * 10
    assert sum(char != "\u2800" for text in lines for char in text) == 4
    bottom_left, top_right = canvas.cell(0.0, 0.0), canvas.cell(100.0, 50.0)
    assert bottom_left.row > top_right.row
    assert bottom_left.column < top_right.column
    assert canvas.cell(1e6, 1e6).row == 0


def test_the_live_page_follows_the_terminal_when_its_size_changes() -> None:
    bus = LocalBus()
    console = Console(width=150, height=40, file=io.StringIO(), record=True)
    view = LiveView(load_track("oval"), console)
    view.close()
    scene = Scene(5 * MS, 1.0, Monitor(bus), DriveReferee(bus), {"plant": 0.1}, {}, "oval on vcan0")
    console.print(view.page(scene))
    assert "processes" in console.export_text()
    console.size = (80, 24)
    console.print(view.page(scene))
    text = console.export_text()
    assert "processes" not in text and max(map(len, text.splitlines())) <= 80


def test_reasons_of_plans_are_told_apart_only_so_far() -> None:
    """A flood of plans, each with another reason, takes no more memory."""
    count = PlanCount()
    for number in range(10 * REASONS_MAX):
        count.add(_plan(f"reason {number}"))
    count.add(_plan("reason 0"))
    assert (len(count.reasons), count.reasons["reason 0"], count.failures) == (REASONS_MAX, 2, 10 * REASONS_MAX + 1)


def _plan(reason: str) -> m.Plan:
    row = (0.0,)
    return m.Plan(
        stamp_ns=0, seq=0, state_stamp_ns=0, status=m.PlanStatus.STOP, reason=reason, dt=0.1, x=row, y=row, yaw=row,
        vx=row, s=row, steer=row, drive=row, lap=0, revision="r", solve_ms=1.0,
    )  # fmt: skip


def test_the_report_of_a_run_in_which_nobody_spoke_is_complete_for_programs_and_people(tmp_path: Path) -> None:
    setup = prepare(DemoOptions(out=tmp_path / "out"))
    with setup.lock:
        bus = LocalBus()
        result = RunResult(Monitor(bus), DriveReferee(bus), Ending.NEVER_STARTED)
        summary = summarise(DemoOptions(), setup, result, unknown("nothing was driven"))
    assert set(json.loads(json.dumps(summary))) >= {
        "laps",
        "failsafes",
        "model_error",
        "events",
        "revisions",
        "session",
    }
    lines = describe(summary)
    assert "model error      not measured: nothing was driven" in lines
    assert "ended            never started" in lines
