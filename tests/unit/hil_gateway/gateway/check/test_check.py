"""Bring-up check on made-up traffic: it names what is wrong, and nothing when nothing is."""

from __future__ import annotations

import io
import json
from collections.abc import Callable

import pytest
from support.cars.check_traffic import CODEC, Values, finding, report, traffic, trouble

from hil_gateway.can_link import Frame, LinkStats, VirtualWire
from hil_gateway.config import Config
from hil_gateway.gateway.check.arming import EXPLANATION
from hil_gateway.gateway.check.finding import Verdict
from hil_gateway.gateway.check.interface import judge_interface, parse_interface
from hil_gateway.gateway.check.report import print_report
from hil_gateway.gateway.check.run import capture, run_check
from hil_gateway.gateway.decide.failsafe import TABLE
from hil_gateway.process.clock import NS_PER_S, VirtualClock
from hil_gateway.process.errors import InputError


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
    cranking = {"mode_without_crank", "car_not_crank_ready", "cranked", "in_emergency"}
    arming = {"car_moving", "mode", "estimate_unfit", "plan_standing", "disagreement", "run_lost"}
    assert {row.cause for row in TABLE} | arming | cranking == set(EXPLANATION)


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
    assert f"failures: {result.failures}, warnings: {result.warnings}" in text
    for words in ("wheel_speed_report", "missing", "state_invalid", "failures", "0x515"):
        assert words in text
