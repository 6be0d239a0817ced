"""The simulated car on its CAN cable: what it sends, what it obeys, and what it does by itself."""

from __future__ import annotations

import itertools
import random
from collections import Counter, defaultdict
from typing import Any

import cantools
import pytest

from can_dbc.codec import load_codec
from can_dbc.folder import SHIPPED
from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.topics import TRUTH
from hil_gateway.can_link import Frame, VirtualWire
from hil_gateway.config import load_config
from hil_gateway.plant.car import Commands
from hil_gateway.plant.controller.ladder import CarState
from hil_gateway.plant.physics.effects import configure
from hil_gateway.plant.plant import Plant
from hil_gateway.process.clock import VirtualClock
from hil_gateway.process.errors import InputError

MS = 1_000_000
CODEC = load_codec()


class Bench:
    """A plant, and a computer whose commands the test writes."""

    def __init__(self, **overrides: Any) -> None:
        self.clock = VirtualClock(5_000 * MS)
        wire = VirtualWire(self.clock)
        self.bus = LocalBus()
        self.plant = Plant(load_config(None, {"track": "oval", **overrides}), wire.link(), self.bus)
        self.link = wire.link()
        self.frames: list[Frame] = []
        self.ct_state = 0
        self.commands: Commands | None = None
        self.counter = 0
        self.counting = True

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 100)):
            self.clock.advance(10 * MS)
            self._send()
            self.plant.step(self.clock.now_ns())
            self.frames += self.link.receive()

    def climb(self) -> None:
        """From power-on to driving, one rung at a time."""
        for ct_state, seconds in ((2, 0.5), (3, 0.5), (4, 0.1), (5, 1.3), (6, 0.1), (7, 0.1), (9, 0.1)):
            self.ct_state = ct_state
            self.run(seconds)

    def _send(self) -> None:
        if self.ct_state:
            self._frame("ct_report", ct_state=self.ct_state)
        if self.commands is None:
            return
        c = self.commands
        self.counter = (self.counter + self.counting) % 256
        self._frame("steering_cmd", steering_motor_ang_cmd=15.0 * c.steer, steering_motor_cmd_counter=self.counter)
        self._frame("accelerator_cmd", acc_pedal_cmd=c.throttle, acc_pedal_cmd_counter=self.counter)
        self._frame(
            "brake_pressure_cmd",
            F_brake_pressure_cmd=c.brake_front,
            R_brake_pressure_cmd=c.brake_rear,
            brk_pressure_cmd_counter=self.counter,
        )
        self._frame("gear_shift_cmd", desired_gear=c.gear)

    def _frame(self, name: str, **values: float) -> None:
        resting = {signal.name: 0.0 for signal in CODEC.messages[name].signals}
        self.link.send(*CODEC.encode(name, {**resting, **values}))

    def last(self, name: str) -> dict[str, float]:
        """Newest values of a message, SI."""
        frame = next(f for f in reversed(self.frames) if f.id == CODEC.messages[name].id)
        values = CODEC.decode(frame.id, frame.data)
        assert isinstance(values, dict)
        return values

    @property
    def sys_state(self) -> int:
        return int(self.last("misc_report")["sys_state"])


@pytest.fixture
def driving() -> Bench:
    bench = Bench()
    bench.climb()
    assert bench.sys_state == CarState.DRIVING
    bench.commands = Commands(throttle=0.6, gear=1)
    bench.run(4.0)
    assert bench.plant.car["vx"] > 10.0
    return bench


def test_every_message_of_the_car_is_sent_at_its_period() -> None:
    bench = Bench()
    bench.run(2.0)
    counts = Counter(frame.id for frame in bench.frames)
    expected = {m.id: round(2.0 / m.period_s) for m in CODEC.messages.values() if m.direction == "car"}
    assert set(counts) == set(expected)
    assert all(abs(counts[i] - expected[i]) <= 1 for i in expected)


def test_frames_decode_with_an_independent_decoder_inside_the_limits() -> None:
    bench = Bench()
    bench.climb()
    bench.commands = Commands(steer=0.02, throttle=0.5, gear=2)
    bench.run(3.0)
    database = cantools.database.load_file(SHIPPED / "av24/av24.dbc")
    for frame in bench.frames:
        values = database.decode_message(frame.id, frame.data)
        for signal in CODEC.by_id[frame.id].signals:
            if signal.limits is not None:
                assert signal.limits[0] <= values[signal.name] <= signal.limits[1], signal.name


def test_report_counters_advance_by_one() -> None:
    bench = Bench()
    bench.run(4.0)
    seen: dict[str, list[int]] = defaultdict(list)
    for frame in bench.frames:
        layout = CODEC.by_id[frame.id]
        if layout.counter is not None:
            values = CODEC.decode(frame.id, frame.data)
            assert isinstance(values, dict)
            seen[layout.name].append(int(values[layout.counter.signal]))
    assert set(seen) >= {"steering_report", "accelerator_report", "brake_pressure_report", "misc_report"}
    for counters in seen.values():
        assert all((b - a) % 256 == 1 for a, b in itertools.pairwise(counters))


def test_ladder_waits_for_the_computer_on_every_rung() -> None:
    bench = Bench()
    bench.run(3.0)
    assert bench.sys_state == CarState.CONNECTED
    for ct_state, expected in (
        (3, CarState.TEST_DONE),
        (4, CarState.CRANK_READY),
        (5, CarState.IDLE),
        (7, CarState.DRIVING),
    ):
        bench.ct_state = ct_state
        bench.run(2.0)
        assert bench.sys_state == expected


def test_commands_move_nothing_below_driving() -> None:
    bench = Bench()
    bench.commands = Commands(steer=0.1, throttle=1.0, gear=1)
    bench.run(3.0)
    assert abs(bench.plant.car["vx"]) < 0.05
    assert abs(bench.last("steering_report_extd")["average_steering_ang_fdbk"]) < 0.05


def test_car_obeys_when_driving(driving: Bench) -> None:
    driving.commands = Commands(steer=0.03, throttle=0.3, gear=2)
    driving.run(0.5)
    assert driving.last("steering_report_extd")["average_steering_ang_fdbk"] / 15.0 == pytest.approx(0.03, abs=2e-3)
    assert driving.last("accelerator_report")["acc_pedal_fdbk"] == pytest.approx(0.3, abs=0.01)
    assert driving.last("pt_report_1")["current_gear"] == 2
    assert driving.last("imu_1")["imu_yaw_rate"] > 0.05
    assert driving.last("imu_1")["imu_ay"] > 1.0


@pytest.mark.parametrize("how", ["no commands", "frozen counters"])
def test_silent_commands_brake_the_car_by_itself_within_200_ms(driving: Bench, how: str) -> None:
    if how == "no commands":
        driving.commands = None
    else:
        driving.counting = False
    driving.run(0.19)
    assert driving.sys_state == CarState.DRIVING
    driving.run(0.05)
    assert driving.sys_state == CarState.EMERGENCY
    assert driving.last("diagnostic_report")["adlink_hb_lost"] == 1
    driving.run(5.0)
    assert abs(driving.plant.car["vx"]) < 0.05


def test_emergency_cuts_the_engine_but_steers_and_brakes_as_asked(driving: Bench) -> None:
    driving.ct_state = 12
    driving.commands = Commands(steer=0.02, throttle=1.0, brake_front=2e6, brake_rear=1e6, gear=1)
    driving.run(0.3)
    assert driving.sys_state == CarState.EMERGENCY
    assert driving.last("accelerator_report")["acc_pedal_fdbk"] < 0.02
    assert driving.last("brake_pressure_report")["brake_pressure_fdbk_front"] == pytest.approx(2e6, rel=0.02)
    assert driving.last("steering_report_extd")["average_steering_ang_fdbk"] / 15 == pytest.approx(0.02, abs=2e-3)


@pytest.mark.parametrize("flag", [32, 33])
def test_purple_flag_and_e_kill_stop_the_car_without_the_computer(driving: Bench, flag: int) -> None:
    driving.plant.race_control.vehicle_flag = flag
    driving.run(0.05)
    assert driving.sys_state == CarState.EMERGENCY


def test_emergency_is_left_standing_still_only(driving: Bench) -> None:
    driving.ct_state = 12
    driving.run(0.1)
    driving.ct_state, driving.commands = 2, None
    driving.run(0.5)
    assert driving.sys_state == CarState.EMERGENCY
    driving.run(8.0)
    assert driving.sys_state == CarState.CONNECTED
    driving.climb()
    assert driving.sys_state == CarState.DRIVING
    driving.run(0.5)
    assert driving.last("accelerator_report")["acc_pedal_fdbk"] < 0.02, "the last command is not obeyed again"


def test_race_control_heartbeat_advances_until_it_stops() -> None:
    bench = Bench()
    bench.run(1.0)
    beats = [CODEC.decode(f.id, f.data)["base_to_car_heartbeat"] for f in bench.frames if f.id == 0x4B0]  # type: ignore[index]
    assert all((b - a) % 16 == 1 for a, b in itertools.pairwise(beats))
    bench.plant.race_control.beating = False
    bench.frames.clear()
    bench.run(1.0)
    assert len({f.data[0] & 15 for f in bench.frames if f.id == 0x4B0}) == 1


def test_steering_answers_after_its_delay_at_its_rate(driving: Bench) -> None:
    car = driving.plant.car
    driving.commands = Commands(throttle=0.1, gear=1)
    driving.run(0.5)
    before = car["steer"]
    driving.commands = Commands(steer=0.15, throttle=0.1, gear=1)
    driving.run(0.04)
    assert car["steer"] == pytest.approx(before, abs=1e-3)
    driving.run(0.1)
    assert car["steer"] - before == pytest.approx(0.1 * 0.5818, rel=0.12)


def test_truth_is_published_at_20_hz_for_the_referee_alone() -> None:
    bench = Bench()
    truth = bench.bus.subscribe(TRUTH, depth=1000)
    bench.run(2.0)
    assert len(truth.poll(0)) == pytest.approx(40, abs=1)


def test_leaving_the_road_is_counted_once_an_excursion(driving: Bench) -> None:
    driving.commands = Commands(steer=-0.05, throttle=0.1, gear=2)  # away from the pit lane
    driving.run(3.0)
    assert driving.plant.referee.off_track_count == 1
    assert driving.plant.referee.off_track


def test_a_pause_of_the_process_is_not_made_up_for() -> None:
    bench = Bench()
    bench.run(1.0)
    bench.frames.clear()
    bench.clock.advance(3_000 * MS)
    bench.plant.step(bench.clock.now_ns())
    assert len(bench.link.receive()) < 100


def test_parameters_of_the_car_can_be_set_one_by_one() -> None:
    assert Bench(**{"plant.car.df": 1.2}).plant.car.parameters.car.df == 1.2
    with pytest.raises(InputError, match=r"plant\.car\.dff is not a number of the simulated car"):
        Bench(**{"plant.car.dff": 1.2})
    for no_car in (-787.0, 0.0, 1e-9, 1e9):
        with pytest.raises(InputError, match=r"plant\.car\.mass = .* is no car: between"):
            Bench(**{"plant.car.mass": no_car})


def test_effects_reach_the_sensors() -> None:
    straight = Bench()
    biased = Bench(**{"plant.effects.imu_bias": 2.0})
    for bench in (straight, biased):
        bench.run(1.0)
    ax = [bench.last("imu_2")["imu_ax"] for bench in (straight, biased)]
    assert ax[1] - ax[0] == pytest.approx(2.0, abs=0.02)  # the same noise in both
    assert configure("paper", {"wind": 5.0}).car.drag > 0  # wind shows through the drag only


@pytest.mark.parametrize("base", ["av24", "paper"])
def test_wheels_tell_the_turn_of_the_car_whatever_its_physics_leave_out(base: str) -> None:
    bench = Bench(**{"plant.base": base, "plant.seed": 3})
    bench.climb()
    bench.commands = Commands(throttle=0.3, gear=1)
    bench.run(4.0)
    bench.commands = Commands(steer=0.05, gear=1)
    bench.run(2.0)
    wheels = bench.last("wheel_speed_report")
    right, left = wheels["wheel_speed_FR"], wheels["wheel_speed_FL"]
    track = bench.plant.car.parameters.car.track_front
    assert bench.plant.car["yaw_rate"] > 0.1
    assert (right - left) / track == pytest.approx(bench.plant.car["yaw_rate"], abs=0.08), "0.1 km/h and noise"


def test_nodes_with_clocks_of_their_own_keep_no_step_and_lose_no_count() -> None:
    bench = Bench()
    bench.plant.run_free(bench.clock.now_ns(), random.Random(1))
    for _ in range(3000):
        bench.clock.advance(MS)
        bench.plant.step(bench.clock.now_ns())
    stamps, counts = defaultdict(list), defaultdict(list)
    for frame in bench.link.receive():
        layout = CODEC.by_id[frame.id]
        stamps[layout.name].append(frame.stamp_ns)
        if layout.counter is not None:
            counts[layout.name].append(CODEC.decode_raw(frame.id, frame.data)[layout.counter.signal])
    phases = {name: stamps[name][0] % (10 * MS) for name in ("imu_1", "wheel_speed_report", "novatel_report")}
    assert len(set(phases.values())) == 3
    for name, times in stamps.items():
        period_ns = CODEC.messages[name].period_s * 1e9
        assert (times[-1] - times[0]) / (len(times) - 1) == pytest.approx(period_ns, rel=3e-4, abs=2 * MS / len(times))
    for name, values in counts.items():
        modulus = CODEC.messages[name].counter.modulus
        assert all((b - a) % modulus == 1 for a, b in itertools.pairwise(values))
