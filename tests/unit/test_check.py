"""Bring-up check on made-up traffic: it names what is wrong, and nothing when nothing is."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable

import numpy as np
import pytest

from can_dbc.codec import load_codec
from hil_gateway.can_link import Frame, LinkStats, VirtualWire
from hil_gateway.check.arming import EXPLANATION
from hil_gateway.check.finding import Finding, Verdict
from hil_gateway.check.interface import judge_interface, parse_interface
from hil_gateway.check.report import Report, print_report
from hil_gateway.check.run import Capture, capture, examine, run_check
from hil_gateway.clock import NS_PER_S, VirtualClock
from hil_gateway.config import Config
from hil_gateway.errors import InputError
from hil_gateway.failsafe import TABLE
from hil_gateway.vehicle import GRAVITY

CODEC = load_codec()
SECONDS = 2.0
Values = dict[str, float]
Change = Callable[[str, float, Values], Values]


def at_rest(name: str, t: float, rng: np.random.Generator) -> Values:
    """What the car says standing still with the engine off, SI."""
    values = dict.fromkeys(CODEC.messages[name].signal, 0.0)
    known = {
        "imu_ax": 0.02 * rng.standard_normal(), "imu_ay": 0.02 * rng.standard_normal(),
        "imu_az": GRAVITY + 0.02 * rng.standard_normal(), "imu_yaw_rate": 0.002 * rng.standard_normal(),
        "imu_roll_rate": 0.002 * rng.standard_normal(), "battery_voltage": 13.2, "sys_state": 2,
        "novatel_lat": math.radians(36.585), "novatel_long": math.radians(-121.7535),
        "base_to_car_heartbeat": int(t * 10) % 16,
    }  # fmt: skip
    return values | {signal: value for signal, value in known.items() if signal in values}


def traffic(change: Change = lambda name, t, values: values) -> list[Frame]:
    """`SECONDS` of every message of the car at its period; `change` edits the values of a frame."""
    rng = np.random.default_rng(3)
    frames = []
    for message in CODEC.messages.values():
        if message.direction == "computer":
            continue
        for index in range(int(SECONDS / message.period_s)):
            t = index * message.period_s
            values = at_rest(message.name, t, rng)
            if message.counter:
                values[message.counter.signal] = index % message.counter.modulus
            frame_id, data = CODEC.encode(message.name, change(message.name, t, values))
            frames.append(Frame(frame_id, data, int(t * NS_PER_S)))
    return sorted(frames, key=lambda frame: frame.stamp_ns)


def report(frames: list[Frame], stats: LinkStats | None = None) -> Report:
    heard = Capture(frames, 0, int(SECONDS * NS_PER_S), 0.001, stats or LinkStats())
    return examine(Config(), "wire", None, heard)


def finding(result: Report, name: str) -> Finding:
    (match,) = [item for item in result.findings if item.name == name]
    return match


def trouble(result: Report) -> set[str]:
    """Names of everything that is not fine."""
    rows = {row.name for row in result.messages if row.verdict in (Verdict.WARN, Verdict.FAIL)}
    return rows | {item.name for item in result.findings if item.verdict in (Verdict.WARN, Verdict.FAIL)}


def test_a_healthy_car_at_rest_has_nothing_to_complain_about() -> None:
    result = report(traffic())
    assert trouble(result) == set()
    assert (result.failures, result.warnings) == (0, 0)
    assert result.frames == len(traffic())
    assert {"command_dead", "estimate_invalid", "car_not_driving"} <= set(result.missing_for_arming)
    assert not {"state_invalid", "can_silent", "heartbeat_frozen", "car_moving"} & set(result.missing_for_arming)


def test_a_silent_bus_is_a_failure_with_a_remedy() -> None:
    result = report([])
    assert finding(result, "traffic").verdict is Verdict.FAIL
    assert "can_silent" in result.missing_for_arming


@pytest.mark.parametrize(
    ("name", "verdict"),
    [("wheel_speed_report", Verdict.FAIL), ("base_to_car_summary", Verdict.WARN), ("mylaps_report_1", Verdict.INFO)],
)
def test_a_missing_message_weighs_what_it_is_needed_for(name: str, verdict: Verdict) -> None:
    result = report([frame for frame in traffic() if frame.id != CODEC.messages[name].id])
    (row,) = [row for row in result.messages if row.name == name]
    assert (row.verdict, row.detail) == (verdict, "missing")


def test_a_message_of_the_wrong_length_is_another_version() -> None:
    frames = [Frame(f.id, f.data[:5], f.stamp_ns) if f.id == 0x517 else f for f in traffic()]
    (row,) = [row for row in report(frames).messages if row.id == 0x517]
    assert row.verdict is Verdict.FAIL
    assert row.wrong_lengths == {5: 200}
    assert "5 bytes where the DBC says 8" in row.detail


@pytest.mark.parametrize(
    ("counter", "found"),
    [
        (lambda index: 7, "stuck"),
        (lambda index: index * 37 % 256, "wrong"),
        (lambda index: (index + (index > 50) * 3) % 256, "gaps"),
        (lambda index: index % 256, "ok"),
    ],
)
def test_counters_are_judged(counter: Callable[[int], int], found: str) -> None:
    def change(name: str, t: float, values: Values) -> Values:
        if name == "steering_report":
            values["steering_motor_fdbk_counter"] = counter(round(t * 100))
        return values

    result = report(traffic(change))
    (row,) = [row for row in result.messages if row.name == "steering_report"]
    assert row.counter == found
    assert (row.verdict is Verdict.OK) == (found == "ok")
    if found == "gaps":
        assert row.detail == "3 frames lost by its counter"


def test_slow_and_interrupted_messages_are_named() -> None:
    frames = traffic()
    half = [f for index, f in enumerate(frames) if f.id != 0x514 or (f.stamp_ns // 10_000_000) % 2]
    (row,) = [row for row in report(half).messages if row.id == 0x514]
    assert (row.verdict, row.detail) == (Verdict.WARN, "50.0 Hz where 100 Hz are due")
    hole = [f for f in frames if f.id != 0x514 or not 0.5 < f.stamp_ns / NS_PER_S < 0.7]
    (row,) = [row for row in report(hole).messages if row.id == 0x514]
    assert (row.verdict, row.detail) == (Verdict.WARN, "silent for 200 ms")


def test_unknown_identifiers_error_frames_and_losses_are_counted() -> None:
    extra = [Frame(0x321, b"1", 10**9), Frame(0x321, b"1", 10**9), Frame(4, bytes(8), 10**9, is_error=True)]
    result = report(sorted(traffic() + extra, key=lambda f: f.stamp_ns), LinkStats(lost=17, malformed=2))
    assert trouble(result) == {"unknown identifiers", "error frames", "lost", "not data"}
    assert result.unknown == {"0x321": 2}
    assert finding(result, "lost").detail.startswith("17 frames")


def test_a_second_computer_is_noticed() -> None:
    extra = [Frame(*CODEC.encode("gear_shift_cmd", {"desired_gear": 1}), stamp_ns=i * 10**7) for i in range(100)]
    result = report(sorted(traffic() + extra, key=lambda f: f.stamp_ns))
    assert trouble(result) == {"gear_shift_cmd"}


def test_load_is_counted_in_bits() -> None:
    """100 frames of 8 bytes in 2 s: 111 bits each without stuffing, 24 more at most."""
    frames = [Frame(0x514, bytes(8), i * 2 * 10**7) for i in range(100)]
    load = finding(report(frames), "load").detail
    assert load == "50 frames/s, 1% of 1000000 bit/s (at most 1% with bit stuffing)"


def edit(target: str, **fixed: float) -> Change:
    return lambda name, t, values: values | fixed if name == target else values


@pytest.mark.parametrize(
    ("change", "name", "words"),
    [
        (edit("imu_3", imu_az=-GRAVITY), "gravity", "up is along -z"),
        (edit("imu_3", imu_az=0.5 * GRAVITY), "gravity", "0.50 g in all"),
        (edit("imu_3", imu_az=GRAVITY), "imu_az", "in all 200 frames"),
        (edit("imu_1", imu_yaw_rate=0.1), "imu_yaw_rate", "+5.73 deg/s"),
        (edit("steering_report_extd", average_steering_ang_fdbk=1.0), "steering centre", "+57.5 deg"),
        (edit("steering_report_extd", secondary_steering_ang_fdbk=0.2), "steering sensors", "apart"),
        (edit("misc_report", battery_voltage=3.0), "battery_voltage", "3 to 3 V, possible are 9 to 16"),
        (edit("base_to_car_summary", base_to_car_heartbeat=3), "race-control heartbeat", "frozen at 3"),
        (edit("novatel_report", novatel_lat=0.0, novatel_long=0.0), "position", "no fix"),
        (edit("novatel_report", novatel_lat=0.7, novatel_long=-1.5), "position", "km from the map's origin"),
    ],
)
def test_implausible_values_at_rest_are_named(change: Change, name: str, words: str) -> None:
    result = report(traffic(change))
    assert name in trouble(result)
    assert any(words in item.detail for item in result.findings if item.name == name)


def pushed(steer_sign: float = 1.0, yaw_sign: float = 1.0, ax_sign: float = 1.0, swap: bool = False) -> Change:
    """Pushed to 2 m/s and slowed down again in a left bend of 12 m radius at the rear axle."""

    def change(name: str, t: float, values: Values) -> Values:
        speed = 2 * math.sin(math.pi * t / SECONDS) ** 2
        yaw = speed / 12.0
        inner, outer = speed - yaw * 1.523 / 2, speed + yaw * 1.523 / 2
        left, right = (outer, inner) if swap else (inner, outer)
        new = {
            "wheel_speed_FL": left, "wheel_speed_RL": left, "wheel_speed_FR": right, "wheel_speed_RR": right,
            "imu_yaw_rate": yaw_sign * yaw, "average_steering_ang_fdbk": steer_sign * 15 * math.atan(2.972 / 12.0),
            "imu_ax": ax_sign * 2 * math.pi / SECONDS * math.sin(2 * math.pi * t / SECONDS),
        }  # fmt: skip
        return values | {signal: value for signal, value in new.items() if signal in values}

    return change


SIGNS = ("yaw rate against wheels", "yaw rate against steering", "acceleration against wheels")


@pytest.mark.parametrize(
    ("change", "wrong"),
    [
        (pushed(), set()),
        (pushed(yaw_sign=-1), {SIGNS[0], SIGNS[1]}),
        (pushed(steer_sign=-1), {SIGNS[1]}),
        (pushed(ax_sign=-1), {SIGNS[2]}),
        (pushed(swap=True), {SIGNS[0]}),
    ],
)
def test_wrong_signs_show_when_the_car_is_pushed(change: Change, wrong: set[str]) -> None:
    result = report(traffic(change))
    assert {name for name in SIGNS if finding(result, name).verdict is Verdict.FAIL} == wrong
    assert finding(result, "wheel speeds").verdict is Verdict.OK


def test_a_dead_wheel_sensor_is_named_when_pushed() -> None:
    def change(name: str, t: float, values: Values) -> Values:
        values = pushed()(name, t, values)
        return values | {"wheel_speed_RR": 0.0} if name == "wheel_speed_report" else values

    assert finding(report(traffic(change)), "wheel speeds").remedy == "sensor of RR"


CONTROLLER = {
    "ifname": "can0", "flags": ["NOARP", "UP", "LOWER_UP", "ECHO"], "link_type": "can",
    "linkinfo": {
        "info_kind": "can",
        "info_data": {
            "ctrlmode": ["LISTEN-ONLY"], "state": "ERROR-ACTIVE", "berr_counter": {"tx": 0, "rx": 3},
            "restart_ms": 100, "bittiming": {"bitrate": 1000000, "sample_point": "0.750"},
        },
        "info_xstats": {"restarts": 0, "bus_error": 0, "error_passive": 0, "bus_off": 0},
    },
    "stats64": {"rx": {"dropped": 0}},
}  # fmt: skip


def verdicts(link: dict[str, object], bitrate: int = 1_000_000) -> dict[str, Verdict]:
    return {item.name: item.verdict for item in judge_interface(parse_interface(link), bitrate)}


def test_a_controller_is_judged_by_what_the_kernel_says() -> None:
    assert parse_interface(CONTROLLER).listen_only is True
    assert verdicts(CONTROLLER) == {
        "link": Verdict.OK, "controller": Verdict.OK, "bitrate": Verdict.OK,
        "restart after bus-off": Verdict.OK, "listen-only": Verdict.INFO,
    }  # fmt: skip
    assert verdicts(CONTROLLER, bitrate=500_000)["bitrate"] is Verdict.FAIL
    changed = json.loads(json.dumps(CONTROLLER))
    changed["linkinfo"]["info_data"] |= {"state": "BUS-OFF", "restart_ms": 0}
    assert verdicts(changed)["controller"] is Verdict.FAIL
    assert verdicts(changed)["restart after bus-off"] is Verdict.WARN
    assert verdicts(CONTROLLER | {"flags": ["NOARP", "ECHO"]}) == {"link": Verdict.FAIL}


def test_every_cause_that_can_refuse_arming_is_explained() -> None:
    assert {row.cause for row in TABLE} | {"car_moving", "mode"} == set(EXPLANATION)


def test_listening_sends_nothing_ends_in_time_and_counts_only_its_own_stretch() -> None:
    clock = VirtualClock()
    wire = VirtualWire(clock)
    ears, car, witness = wire.link(), wire.link(), wire.link()

    class Ticking:
        """The link, with time passing while it waits."""

        kind = "wire"

        def receive(self, timeout_s: float = 0.0) -> list[Frame]:
            clock.advance(int(timeout_s * NS_PER_S))
            car.send(*CODEC.encode("gear_shift_cmd", {"desired_gear": 1}))
            return ears.receive()

        def send(self, frame_id: int, data: bytes) -> bool:
            raise AssertionError("the check sent something")

        stats, close = ears.stats, ears.close

    heard = capture(Ticking(), clock, 1.0)
    assert (len(heard.frames), heard.end_ns - heard.start_ns) == (100, NS_PER_S)
    assert len(witness.receive()) == 101  # the one that was pending is left out


def test_bad_arguments_are_one_line() -> None:
    with pytest.raises(InputError, match="--seconds -1"):
        run_check(Config(), seconds=-1)
    with pytest.raises(InputError, match="nocan0"):
        run_check(Config(), channel="nocan0")


def test_the_printed_report_names_trouble_and_what_arming_needs() -> None:
    from rich.console import Console

    result = report([frame for frame in traffic() if frame.id != 0x514])
    console = Console(width=140, file=io.StringIO())
    print_report(result, console)
    text = console.file.getvalue()  # type: ignore[attr-defined]
    for words in ("wheel_speed_report", "missing", "state_invalid", "failures", "0x515"):
        assert words in text
