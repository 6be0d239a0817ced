"""ROS 2 bags of drive messages as a drive log: one drive through every kind of bag, held against what was driven."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from support.drives import bags
from support.drives.drive_simulator import TYRE, simulate

from estimator.drive_log.table import DriveLog, read_log
from estimator.drive_log.tables import read_table
from hil_gateway.bus import messages as m
from hil_gateway.bus.topics import ESTIMATE, VEHICLE_STATE
from hil_gateway.can_link import Frame
from hil_gateway.can_link.cdr import pack_frame
from hil_gateway.car.actuation import Actuation
from hil_gateway.car.car import load_car
from hil_gateway.process.errors import InputError
from hil_gateway.session.exchange.formats import EXPORTS
from hil_gateway.session.exchange.ros2 import export_ros2
from hil_gateway.session.files.format import CAN_TOPIC
from hil_gateway.session.files.writer import SessionFile

DRIVEN = dict(simulate([TYRE], 20.0, seed=3)[0].columns)
_TO_MAP = np.exp(1j * DRIVEN["yaw"]) * (DRIVEN["vx"] + 1j * DRIVEN["vy"])
_PLACE = np.cumsum(_TO_MAP * np.gradient(DRIVEN["t"]))
DRIVEN |= {"x": _PLACE.real, "y": _PLACE.imag}
TYPES = bags.store()
CAR = bags.Car(DRIVEN, TYPES)
LATE_S = 0.03


def indy() -> list[bags.Message]:
    top = "/novatel_top"
    return [
        *CAR.inertial(f"{top}/inspva", LATE_S), *CAR.raw_imu(f"{top}/rawimu", LATE_S),
        *CAR.wheels(), *CAR.steering(),
    ]  # fmt: skip


def plain(on_map: bool = False, wheels_late_s: float = 0.0) -> list[bags.Message]:
    return [*CAR.odometry(on_map=on_map), *CAR.imu(), *CAR.steering(), *CAR.wheels(wheels_late_s)]


def off(log: DriveLog, name: str) -> float:
    """Largest difference from what was driven, over its spread; without the first and last second."""
    inside = (log["t"] > log["t"][0] + 1.0) & (log["t"] < log["t"][-1] - 1.0)
    driven = CAR.at(name, log["t"])
    return float(np.abs(log[name] - driven)[inside].max() / np.std(driven))


@pytest.fixture(scope="module")
def indy_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bags.write(tmp_path_factory.mktemp("indy") / "bag", indy(), TYPES)


def test_a_bag_of_receiver_and_car_is_a_drive_log_in_car_axes(indy_bag: Path) -> None:
    log = read_log(indy_bag)
    for name in ("vx", "vy", "yaw_rate", "steer", "ax", "ay"):
        assert off(log, name) < (0.35 if name in ("ax", "ay") else 0.1), name  # accelerometers carry noise
    assert np.median(log["wheel_speed_rl"] / log["vx"]) == pytest.approx(1.02, abs=0.002)
    notes = " ".join(log.notes)
    assert "mounted turned by" in notes
    assert "km/h, whatever the definition says" in notes
    assert "sent again with an old stamp" in notes
    assert f"published {1e3 * LATE_S:.0f} ms after it was measured" in notes


def test_place_and_heading_of_a_receiver_are_those_of_the_car(indy_bag: Path) -> None:
    log = read_log(indy_bag)
    assert np.ptp((log["x"] - CAR.at("x", log["t"]))[:-1]) < 0.1
    assert np.abs(np.angle(np.exp(1j * (log["yaw"] - CAR.at("yaw", log["t"])))))[:-1].max() < 0.01


@pytest.mark.parametrize("on_map", [False, True])
def test_odometry_whose_velocity_is_along_the_map_is_turned(tmp_path: Path, on_map: bool) -> None:
    log = read_log(bags.write(tmp_path / "bag", plain(on_map), TYPES))
    assert max(off(log, "vx"), off(log, "vy")) < 0.1
    assert any("east and north" in note for note in log.notes) == on_map


def test_driven_wheels_that_slip_with_the_acceleration_are_not_taken_for_early(tmp_path: Path) -> None:
    """Rear wheels are faster by their slip, 0.005 a m/s2: at 40 m/s their derivative leads by 0.2 s."""
    messages = [*CAR.odometry(), *CAR.imu(), *CAR.steering(), *CAR.wheels(slip=0.005)]
    log = read_log(bags.write(tmp_path / "bag", messages, TYPES))
    assert not any("against ax" in note for note in log.notes)


def test_a_late_source_is_put_where_the_accelerometer_is_and_that_is_said(tmp_path: Path) -> None:
    log = read_log(bags.write(tmp_path / "bag", plain(wheels_late_s=0.15), TYPES))
    said = next(note for note in log.notes if "late against ax" in note)
    assert float(said.split(" is ")[1].split()[0]) == pytest.approx(150.0, abs=15.0)
    assert np.abs(log["wheel_speed_fl"] - log["vx"])[100:-100].max() < 0.5


def _without_definitions(folder: Path) -> None:
    """As bags up to Humble are."""
    for file in folder.glob("*.db3"):
        with sqlite3.connect(file) as database:
            database.execute("DELETE FROM message_definitions")


def test_a_bag_without_definitions_is_read_by_those_of_its_packages(tmp_path: Path) -> None:
    bag = bags.write(tmp_path / "bag", indy(), TYPES, "sqlite3")
    with_them = read_log(bag)
    _without_definitions(bag)
    log = read_log(bag)
    assert all(np.array_equal(log[name], with_them[name]) for name in with_them.columns)
    assert any("no definitions of novatel_oem7_msgs: those of iac" in note for note in log.notes)


def kinds_of_bag(tmp_path: Path) -> Iterator[Path]:
    short = [m for m in plain() if m[2] < bags.START_NS + 5 * 10**9]
    folder = bags.write(tmp_path / "mcap", short, TYPES)
    yield next(folder.glob("*.mcap"))
    yield bags.write(tmp_path / "db3", short, TYPES, "sqlite3")
    for mode in (CompressionMode.MESSAGE, CompressionMode.FILE):
        writer = Writer(tmp_path / mode.name, version=9, storage_plugin=StoragePlugin.SQLITE3)
        writer.set_compression(mode, CompressionFormat.ZSTD)
        with writer:
            bags.add(writer, short, TYPES)
        yield tmp_path / mode.name
    half = len(short) // 2
    parts = sorted(short, key=lambda m: m[2])
    split = tmp_path / "split"
    split.mkdir()
    for i, messages in enumerate((parts[:half], parts[half:])):
        part = next(bags.write(tmp_path / f"part{i}", messages, TYPES).glob("*.mcap"))
        part.rename(split / f"split_{i}.mcap")
    yield split


def test_one_drive_is_the_same_through_every_kind_of_bag(tmp_path: Path) -> None:
    first, *others = (read_log(bag) for bag in kinds_of_bag(tmp_path))
    assert len(others) == 4
    for log in others:
        assert all(np.allclose(log[name], first[name], atol=1e-9) for name in ("vx", "vy", "yaw_rate", "ax", "steer"))


def test_a_silent_source_leaves_a_gap(tmp_path: Path) -> None:
    def heard(message: bags.Message) -> bool:
        return message[0] != "/odom" or not 5.0 < (message[2] - bags.START_NS) / 1e9 < 8.0

    log = read_log(bags.write(tmp_path / "bag", [m for m in plain() if heard(m)], TYPES))
    assert log.segment[-1] == 1
    assert off(log, "vx") < 0.1


@pytest.mark.parametrize(
    ("messages", "said"),
    [
        (lambda: [*CAR.imu(), *CAR.odometry()], "steering angle"),
        (lambda: [*CAR.imu(), *CAR.steering()], "velocity"),
        (lambda: [*CAR.wheels()], "velocity"),
    ],
)
def test_what_a_bag_lacks_is_said_in_one_line(tmp_path: Path, messages: Any, said: str) -> None:
    bag = bags.write(tmp_path / "bag", messages(), TYPES)
    with pytest.raises(InputError, match=said) as error:
        read_log(bag)
    assert "\n" not in str(error.value)


def _pressed(drive: float, vx: float) -> dict[str, float]:
    """What a car reports of its pedals in third gear for this drive, and the drive that it comes to."""
    car, gear = load_car(), 3
    speed = vx * car.powertrain.ratio(gear) / car.vehicle.wheel_radius
    actuation = Actuation(car.vehicle, car.powertrain)
    pedals = actuation.to_actuators(0.0, drive, gear, speed, gear)
    pressed = {"accelerator": pedals.accelerator, "throttle": pedals.accelerator, "gear": gear, "engine_speed": speed}
    brakes = {"brake_front": pedals.brake_front, "brake_rear": pedals.brake_rear}
    return {**pressed, **brakes, "drive": actuation.to_drive(pedals, speed, gear)}


def _session(path: Path, gear: int = 3) -> Path:
    """A recording of the drive: states, valid estimates and a frame; the car says it is in `gear`."""
    needed = [name for name, field in m.VehicleState.model_fields.items() if field.is_required()]
    state = dict.fromkeys(needed, 0) | {"sources": {}, "valid": True}
    with SessionFile(path, {}) as file:
        for i in range(500):
            ns, row = i * 10_000_000, {name: float(DRIVEN[name][i]) for name in DRIVEN}
            speeds = {f"wheel_speed_{w}": row["vx"] for w in ("fl", "fr", "rl", "rr")}
            shared = {n: row[n] for n in ("ax", "ay", "yaw_rate", "steer")} | _pressed(row["drive"], row["vx"])
            said = m.VehicleState.model_validate(
                state | {"stamp_ns": ns, "seq": i, "az": 9.8} | speeds | shared | {"gear": gear}
            )
            moving = {n: row[n] for n in ("x", "y", "yaw", "vx", "vy", "yaw_rate", "steer")}
            estimate = m.Estimate(
                stamp_ns=ns + 1000, seq=i, state_stamp_ns=ns, valid=True, bias_ax=0, bias_ay=0, bias_yaw_rate=0,
                std=(0.1,) * 9, drive=0, innovations_rejected=0, **moving,
            )  # fmt: skip
            for topic, message in ((VEHICLE_STATE, said), (ESTIMATE, estimate)):
                data = message.model_dump_json().encode()
                file.add(topic.key, data, bags.START_NS + ns + 2000, bags.START_NS + message.stamp_ns, i)
        file.add(CAN_TOPIC, pack_frame(Frame(0x514, bytes(8), 0), 0), bags.START_NS, bags.START_NS, 0)
    return path


def test_a_session_exported_to_ros_2_is_the_same_drive(tmp_path: Path) -> None:
    session = _session(tmp_path / "s.mcap")
    assert export_ros2(session, tmp_path / "ros.mcap").rows == 1
    log = read_log(tmp_path / "ros.mcap")
    assert "vy" in log.derived
    for name in ("vx", "vy", "yaw_rate", "ax", "ay", "steer", "x", "y", "wheel_speed_rl"):
        there = np.interp(log["t"], np.arange(500) / 100.0, DRIVEN["vx" if "wheel" in name else name][:500])
        assert np.allclose(log[name], there, atol=1e-3 * np.ptp(there)), name
    with AnyReader([tmp_path / "ros.mcap"]) as reader:
        kinds = {c.msgtype for c, _, data in reader.messages() if reader.deserialize(data, c.msgtype)}
    assert {"nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu", "raptor_dbw_msgs/msg/SteeringReport"} <= kinds


@pytest.mark.parametrize(("name", "error"), [("csv", 1e-8), ("parquet", 1e-8), ("motec", 1e-8), ("ros2", 1e-5)])
def test_a_session_is_the_same_drive_log_in_every_format(tmp_path: Path, name: str, error: float) -> None:
    """And says in each that its vy is estimated: as a sensor's, it would bend the tyres that are found by a fifth."""
    session, target = _session(tmp_path / "s.mcap"), tmp_path / "exported"
    EXPORTS[name](session, target)
    recorded, exported = read_log(session), read_log(target)
    assert exported.derived == recorded.derived
    assert "vy" in exported.derived
    assert set(exported.columns) == set(recorded.columns)
    assert np.ptp(recorded["drive"]) > 0.02
    assert all(np.allclose(exported[n], recorded[n], rtol=error, atol=error) for n in recorded.columns)


@pytest.mark.parametrize("gear", [0, 4, 9])
def test_a_power_train_that_is_not_the_bags_makes_no_drive(tmp_path: Path, gear: int) -> None:
    """Gears that are not reported, or that are those of another car: the drive would be without its throttle."""
    export_ros2(_session(tmp_path / "s.mcap", gear), tmp_path / "ros.mcap")
    log = read_log(tmp_path / "ros.mcap")
    assert "drive" in log.derived
    assert any("are not those of the power train" in note for note in log.notes)


def test_damage_never_ends_in_a_traceback(tmp_path: Path, indy_bag: Path) -> None:
    data = bytearray(next(indy_bag.glob("*.mcap")).read_bytes())
    rng = np.random.default_rng(1)
    for i in range(3):
        hurt = data[: len(data) * (i + 1) // 4]
        for at in rng.integers(60, len(hurt), 5 * i):
            hurt[at] ^= 0xFF
        file = tmp_path / f"{i}.mcap"
        file.write_bytes(bytes(hurt))
        try:
            table = read_table(file)
        except InputError:
            continue
        assert table.values.shape[1] == len(table.names)


def test_real_captures_of_a_receiver_are_read_or_refused_in_one_line(measured_data: Path) -> None:
    files = sorted((measured_data / "novatel").glob("*.db3"))
    assert files
    for file in files:
        with pytest.raises(InputError) as error:
            read_log(file)
        assert "\n" not in str(error.value)


def test_one_stamp_of_another_century_moves_nothing(tmp_path: Path) -> None:
    messages = plain()
    at = next(i for i, message in enumerate(messages) if message[0] == "/imu" and message[2] > bags.START_NS + 10**9)
    messages[at][3].header.stamp.sec = 2**31 - 1
    log = read_log(bags.write(tmp_path / "bag", messages, TYPES))
    assert len(log) < 2000
    assert off(log, "yaw_rate") < 0.1
