"""Car folders at random: what is written into a frame is read from it, and no command leaves the car's limits."""

from __future__ import annotations

import itertools
import random
import re
import shutil
from pathlib import Path

import cantools
import pytest
from support.promise_figures import volume

from can_dbc.codec import COUNTER, Fault
from can_dbc.folder import SHIPPED
from hil_gateway.car.actuation import ActuatorPositions
from hil_gateway.car.car import Car, load_car
from hil_gateway.car.states import CtState, computer_codes
from hil_gateway.gateway.act.limits import Limits
from hil_gateway.settings.gateway import LimitConfig

NEW = itertools.count()


def random_folder(rng: random.Random, folder: Path) -> Path:
    """The invented car with other identifiers, scales, offsets, signs and codes."""
    shutil.copytree(SHIPPED / "kestrel", folder)
    ids = iter(rng.sample(range(1, 0x7FF), 40))
    dbc = (folder / "kestrel.dbc").read_text()
    extended = [rng.random() < 0.5 for _ in range(40)]
    numbers = ((1 << 31) + 7919 * next(ids) if wide else next(ids) for wide in extended)
    dbc = re.sub(r"BO_ \d+", lambda _: f"BO_ {next(numbers)}", dbc)
    for signal in ("STR_ANG", "STR_FB"):
        dbc = re.sub(
            rf"({signal} : \S+) \(0.02,0\)", rf"\1 ({rng.choice((0.02, 0.015, 0.025))},{rng.choice((0, -5, 5))})", dbc
        )
    (folder / "kestrel.dbc").write_text(dbc)
    signals = (folder / "signals.toml").read_text()
    sign = rng.choice((-1, 1))
    signals = signals.replace('"STR_ANG", factor = -1', f'"STR_ANG", factor = {sign}')
    for code, new in zip(("10", "20", "21", "30", "40", "50", "90", "255"), rng.sample(range(1, 256), 8), strict=True):
        signals = re.sub(
            rf"^((?:init|crank\w*|race\w*|nominal\w*|coord\w*|contr\w*|emergency) = ){code}$",
            rf"\g<1>{new}000",
            signals,
            flags=re.M,
        )
    (folder / "signals.toml").write_text(re.sub(r"^(\w+ = \d+)000$", r"\1", signals, flags=re.M))
    return folder


@pytest.fixture(params=range(volume(4, 200)))
def made(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Car, Path, random.Random]:
    rng = random.Random(request.param)
    folder = random_folder(rng, tmp_path / f"car{next(NEW)}")
    return load_car(str(folder)), folder, rng


def test_what_is_encoded_is_decoded_by_us_and_by_cantools(made: tuple[Car, Path, random.Random]) -> None:
    car, folder, rng = made
    codec, peer = car.codec, cantools.database.load_file(folder / "kestrel.dbc")
    for message in codec.messages.values():
        places = {n: p for table in (codec.signals.reports, codec.signals.commands) for n, p in table.items()
                  if p.message is message}  # fmt: skip
        raw = {n: rng.randint(*p.signal.raw_range) for n, p in places.items()}
        values = {n: raw[n] * p.scale + p.zero for n, p in places.items()} | {COUNTER: 3}
        number, data = codec.encode_quantities(message.name, values)
        back = codec.decode_quantities(number, data)
        assert not isinstance(back, Fault)
        theirs = peer.get_message_by_name(message.name).decode(data, decode_choices=False)
        for name, place in places.items():
            assert back[name] == pytest.approx(values[name], abs=1e-6 + 1e-9 * abs(values[name]))
            expected = (values[name] - place.offset) / place.factor
            assert float(theirs[place.signal.name]) == pytest.approx(expected, abs=1e-6 + 1e-6 * abs(expected))


def test_no_command_leaves_the_range_or_the_rate_of_the_car(made: tuple[Car, Path, random.Random]) -> None:
    car, _, rng = made
    limits = Limits(car, LimitConfig().within(car))
    motor = car.actuators.steering_range * car.vehicle.steering_ratio
    command = limits.resting(0.0)
    before = limits.to_actuators(command)
    for _ in range(300):
        wanted = ActuatorPositions(
            rng.gauss(0, motor), rng.gauss(0, 1), rng.gauss(0, 8e6), rng.gauss(0, 8e6), rng.randint(-3, 9)
        )
        command, _ = limits.apply(wanted, command)
        sent = limits.to_actuators(command)
        assert abs(sent.steering_motor) <= motor + 1e-9
        assert abs(sent.steering_motor - before.steering_motor) <= 0.01 * car.actuators.steering_rate + 1e-9
        assert 0.0 <= sent.accelerator <= 1.0 and 0 <= sent.gear <= len(car.powertrain.gears)
        for now, then in ((sent.brake_front, before.brake_front), (sent.brake_rear, before.brake_rear)):
            assert -1e-6 <= now <= car.powertrain.brake_pressure_max + 1e-6
            assert -0.01 * car.actuators.brake_fall - 1e-6 <= now - then <= 0.01 * car.actuators.brake_rise + 1e-6
        assert sent.accelerator == 0.0 or max(sent.brake_front, sent.brake_rear) <= 50e3
        before = sent


def test_the_rungs_of_another_ladder_keep_their_order(made: tuple[Car, Path, random.Random]) -> None:
    car, _, _ = made
    declared = car.codec.signals.codes["ct_state"]
    codes = computer_codes(declared)
    assert set(codes.values()) == set(declared.values())
    assert codes[CtState.EMERGENCY] == declared["emergency"] != codes[CtState.NOMINAL_RACE]
    assert codes[CtState.ACTUATOR_TEST] == declared["init"], "no rung of its own: the one below is said"
    assert codes[CtState.CAUTION] == declared["nominal_race"]
