"""Drive logs as other programs write them: the same columns out of every dialect, every conversion said."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support.drives.drive_simulator import TYRE, simulate

from estimator.drive_log.column_map import as_toml, proposed, read_map
from estimator.drive_log.quantities import normal_unit, quantity_of
from estimator.drive_log.table import DriveLog, read_log
from estimator.drive_log.tables import read_table
from hil_gateway.process.arrays import Array
from hil_gateway.process.errors import InputError
from hil_gateway.session.drive_table import DriveTable
from hil_gateway.session.exchange import motec as motec_export

SIMULATED = simulate([TYRE], 8.0, seed=3)[0].columns
PICKED = ("t", "vx", "vy", "yaw_rate", "ax", "ay", "steer", "drive")
DRIVE = {name: SIMULATED[name] for name in PICKED}
_TO_MAP = np.exp(1j * SIMULATED["yaw"]) * (DRIVE["vx"] + 1j * DRIVE["vy"])
_PLACE = np.cumsum(_TO_MAP * np.gradient(DRIVE["t"]))
DRIVE |= {"x": _PLACE.real, "y": _PLACE.imag}
G, DEG = 9.80665, np.pi / 180.0


def text(columns: dict[str, Array], separator: str = ",", decimal: str = ".", quote: str = "", end: str = "") -> str:
    def row(cells: list[str]) -> str:
        return separator.join(f"{quote}{cell}{quote}" for cell in cells) + end + "\n"

    rows = zip(*columns.values(), strict=True)
    return row([*columns]) + "".join(row([f"{v:.9g}".replace(".", decimal) for v in values]) for values in rows)


def with_line(after: int, *lines: str) -> str:
    rows = text(DRIVE).splitlines()
    return "\n".join([*rows[:after], *lines, *rows[after:]]) + "\n"


def motec() -> str:
    names = ["Time", "Ground Speed", "Lateral Velocity", "Yaw Rate", "G Force Long", "G Force Lat", "Steered Angle"]
    units = ["s", "km/h", "km/h", "deg/s", "G", "G", "deg"]
    scale = [1.0, 3.6, 3.6, 1 / DEG, 1 / G, 1 / G, 1 / DEG]
    picked = ("t", "vx", "vy", "yaw_rate", "ax", "ay", "steer")
    columns = dict(zip(names, (DRIVE[n] * k for n, k in zip(picked, scale, strict=True)), strict=True))
    columns |= {"drive": DRIVE["drive"], "x": DRIVE["x"], "y": DRIVE["y"]}
    rows = text(columns, quote='"').splitlines()
    head = ['"Format","MoTeC CSV File",,,"Workbook",""', '"Rate","100.000","Hz","","End Time","60.0","s"', "", ""]
    unit_row = ",".join(f'"{unit}"' for unit in [*units, "", "m", "m"])
    return "\n".join([*head, rows[0], unit_row, "", *rows[1:]]) + "\n"


DIALECTS: dict[str, Callable[[], bytes]] = {
    "semicolons": lambda: text(DRIVE, ";").encode(),
    "decimal commas": lambda: text(DRIVE, ";", ",").encode(),
    "tabs": lambda: text(DRIVE, "\t").encode(),
    "quotes": lambda: text(DRIVE, quote='"').encode(),
    "a separator at the end": lambda: text(DRIVE, end=",").encode(),
    "a row of units": lambda: with_line(1, "s,m/s,m/s,rad/s,m/s2,m/s2,rad,-,m,m").encode(),
    "units in brackets": lambda: text(DRIVE).replace("vx,vy,yaw_rate", "vx [m/s],vy,yaw_rate (rad/s)", 1).encode(),
    "a comment above": f"# logged by hand on Monday\n\n{text(DRIVE)}".encode,
    "an index": lambda: text({"": np.arange(len(DRIVE["t"])), **DRIVE}).encode(),
    "MoTeC": lambda: motec().encode(),
    "Windows": lambda: text({**DRIVE, "Öltemperatur": DRIVE["t"]}).replace("\n", "\r\n").encode("cp1252"),
    "UTF-16": lambda: text(DRIVE).encode("utf-16"),
    "packed": lambda: gzip.compress(text(DRIVE).encode()),
}


def read(path: Path, data: bytes) -> DriveLog:
    path.write_bytes(data)
    return read_log(path)


def same(log: DriveLog) -> bool:
    return all(np.allclose(log[n], DRIVE[n], rtol=1e-7, atol=1e-7) for n in DRIVE)


@pytest.mark.parametrize("dialect", DIALECTS)
def test_every_dialect_gives_the_same_columns(tmp_path: Path, dialect: str) -> None:
    assert same(read(tmp_path / "a log", DIALECTS[dialect]()))


def test_every_conversion_is_said(tmp_path: Path) -> None:
    notes = " ".join(read(tmp_path / "a.csv", motec().encode()).notes)
    assert "vx is 'Ground Speed' in km/h: multiplied by 0.277778" in notes
    assert "yaw_rate is 'Yaw Rate' in deg/s" in notes
    assert "ay is 'G Force Lat' in G" in notes


@pytest.mark.parametrize("last", ["y", "lap"])
def test_what_is_exported_for_i2_is_read_back_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, last: str
) -> None:
    """Also where the last column has no unit."""
    columns = {**DRIVE, "lap": np.floor(DRIVE["t"] / 3.0)} if last == "lap" else dict(DRIVE)
    table = DriveTable(columns, 0, {}, (), np.zeros(len(DRIVE["t"]), bool))
    monkeypatch.setattr(motec_export, "read_drive_table", lambda _: table)
    (tmp_path / "s.mcap").touch()
    motec_export.export_motec(tmp_path / "s.mcap", tmp_path / "s_motec.csv")
    lines = (tmp_path / "s_motec.csv").read_text().splitlines()
    assert lines[0].startswith('"Format","MoTeC CSV File"')
    assert '"Ground Speed"' in next(line for line in lines if line.startswith('"Time"'))
    assert same(read_log(tmp_path / "s_motec.csv"))


def test_times_of_day_and_dates_become_seconds(tmp_path: Path) -> None:
    def stamped(write: Callable[[float], str]) -> bytes:
        head, *rows = text(DRIVE).splitlines()
        body = (f"{write(t)},{row.split(',', 1)[1]}" for t, row in zip(DRIVE["t"], rows, strict=True))
        return ("\n".join([head, *body]) + "\n").encode()

    def clock(t: float) -> str:
        t = (t + 86_400.0 - 10.0) % 86_400.0  # midnight passes
        return f"{int(t) // 3600:02d}:{int(t) // 60 % 60:02d}:{t % 60:06.3f}"

    for data in (stamped(clock), stamped(lambda t: f"2026-11-09T15:{int(t) // 60:02d}:{t % 60:06.3f}")):
        log = read(tmp_path / "a.csv", data)
        assert np.allclose(log["t"] - log["t"][0], DRIVE["t"] - DRIVE["t"][0], atol=2e-3)
        german = data.replace(b",", b";").replace(b".", b",")
        if b"T15" not in data:
            assert np.array_equal(read(tmp_path / "b.csv", german)["t"], log["t"])


@pytest.mark.parametrize("nothing", ["", "nan", "NA", "#N/A"])
def test_slow_positions_are_put_in_between_and_that_is_said(tmp_path: Path, nothing: str) -> None:
    rows = text(DRIVE).splitlines()
    for i in range(1, len(rows)):
        if i % 20 != 1:
            rows[i] = ",".join([*rows[i].split(",")[:-2], nothing, nothing])
    log = read(tmp_path / "a.csv", ("\n".join(rows) + "\n").encode())
    assert np.abs(log["x"] - DRIVE["x"])[:-20].max() < 0.3
    assert any("column x has values in" in note for note in log.notes)


def test_what_tyres_are_found_from_is_never_put_in_between(tmp_path: Path) -> None:
    rows = text(DRIVE).splitlines()
    rows[50] = rows[50].replace(rows[50].split(",")[2], "", 1)
    with pytest.raises(InputError, match="row 51, column vy"):
        read(tmp_path / "a.csv", ("\n".join(rows) + "\n").encode())


def test_a_map_says_what_names_do_not(tmp_path: Path) -> None:
    odd = {"zeit": DRIVE["t"], "v": 3.6 * DRIVE["vx"], "q": -DRIVE["vy"], "w": DRIVE["yaw_rate"]}
    odd["lenk"] = 9.3 * DRIVE["steer"] / DEG
    odd |= {n: DRIVE[n] for n in ("ax", "ay", "drive", "x", "y")}
    (tmp_path / "a.csv").write_text(text(odd))
    with pytest.raises(InputError, match="column t is missing"):
        read_log(tmp_path / "a.csv")
    (tmp_path / "map.toml").write_text(
        't = {from = "zeit"}\nvx = {from = "v", unit = "km/h"}\nvy = {from = "q", sign = -1}\n'
        'yaw_rate = {from = "w"}\nsteer = {from = "lenk", unit = "deg", ratio = 9.3}\n'
        + "".join(f'{n} = {{from = "{n}"}}\n' for n in ("ax", "ay", "drive", "x", "y"))
    )
    assert same(read_log(tmp_path / "a.csv", read_map(tmp_path / "map.toml")))


def test_the_proposed_map_reads_the_log_as_it_is_read_without(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(motec())
    table = read_table(tmp_path / "a.csv")
    (tmp_path / "map.toml").write_text(as_toml(proposed(table.names, table.units)))
    assert same(read_log(tmp_path / "a.csv", read_map(tmp_path / "map.toml")))


def edited(content: str, *changes: tuple[str, str], folder: Path) -> DriveLog:
    """A log by the map that is proposed for it, changed by a person: a table, and what is put in its stead."""
    (folder / "a.csv").write_text(content)
    table = read_table(folder / "a.csv")
    tables = dict(zip(("", *(q := proposed(table.names, table.units)).sources), as_toml(q).split("["), strict=True))
    for quantity, entry in changes:
        tables[quantity] = f"{quantity}]\n{entry}\n" if entry else ""
    (folder / "map.toml").write_text("".join(f"[{entry}" for entry in tables.values() if entry))
    return read_log(folder / "a.csv", read_map(folder / "map.toml"))


def test_a_unit_that_the_file_has_wrong_is_corrected_in_the_map(tmp_path: Path) -> None:
    wrong = motec().replace('"km/h","km/h"', '"m/s","m/s"')
    speeds = ("vx", 'from = "Ground Speed"\nunit = "km/h"'), ("vy", 'from = "Lateral Velocity"\nunit = "km/h"')
    assert same(edited(wrong, *speeds, folder=tmp_path))


@pytest.mark.parametrize("content", [text(DRIVE), motec()])
def test_a_quantity_that_is_taken_out_of_the_map_is_not_used(tmp_path: Path, content: str) -> None:
    log = edited(content, ("ay", ""), folder=tmp_path)
    assert "ay" in log.derived
    with pytest.raises(InputError, match="column vy is missing"):
        edited(content, ("vy", ""), folder=tmp_path)


@pytest.mark.parametrize("scale", [1.0, 1e3])
def test_a_declared_delay_is_in_seconds_and_makes_up_no_row(tmp_path: Path, scale: float) -> None:
    """Also where t is in ms and nobody says so."""
    late = {**DRIVE, "yaw_rate": np.interp(DRIVE["t"] - 0.1, DRIVE["t"], DRIVE["yaw_rate"]), "t": scale * DRIVE["t"]}
    log = edited(text(late), ("yaw_rate", 'from = "yaw_rate"\ndelay = 0.1'), folder=tmp_path)
    assert len(log) == len(DRIVE["t"]) - 10
    assert np.allclose(log["yaw_rate"], DRIVE["yaw_rate"][:-10], atol=1e-6)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ('speed = {from = "v"}\n', "no quantity of a drive log"),
        ('vx = {from = "v", unit = "volts"}\n', "no unit of vx"),
        ('vx = {from = "v", sing = -1}\n', "sing"),
        ('vx = {from = "v", sign = 2}\n', "sign"),
        ('vx = {from = "v"}\nvy = {from = "v"}\n', r"\[vy\] from = 'v': \[vx\] has it already"),
        ('[vx]\nfrom = "v"\n[vx]\nfrom = "w"\n', "twice"),
        ('t = {from = "t", delay = 0.1}\n', "give the delay to the channels that lag"),
        ('vx = {from = "v", ratio = 15.0}\n', r"only \[steer\] has one"),
    ],
)
def test_a_map_that_means_nothing_is_refused(tmp_path: Path, content: str, words: str) -> None:
    (tmp_path / "map.toml").write_text(content)
    with pytest.raises(InputError, match=words):
        read_map(tmp_path / "map.toml")


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("Yaw Rate", ("yaw_rate", "")), ("vx_kmh", ("vx", "km/h")), ("yaw_rate_deg", None),
        ("WheelSpeed_FL", ("wheel_speed_fl", "")), ("Steering Wheel Angle", ("steer", "")),
        ("ax_g", ("ax", "g")), ("oil_temperature", None), ("ax_logged", None),
    ],
)  # fmt: skip
def test_names_are_known_or_left_alone(name: str, found: tuple[str, str] | None) -> None:
    assert quantity_of(name) == found


def test_a_unit_of_another_kind_is_no_guess(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"column vx, taken for vx: unit 'deg'"):
        read(tmp_path / "a.csv", text(DRIVE).replace("vx,", "vx [deg],", 1).encode())


def test_parquet_is_read(tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table({**DRIVE, "driver": ["A"] * len(DRIVE["t"])}), tmp_path / "a.parquet")
    log = read_log(tmp_path / "a.parquet")
    assert same(log)
    assert any("driver" in note for note in log.notes)


def test_vbo_is_read_with_its_own_units_and_frame(tmp_path: Path) -> None:
    latitude, longitude = 48.0 + DRIVE["y"] / 111_190.0, 11.0 + DRIVE["x"] / (111_412.0 * np.cos(np.radians(48.0)))
    others = [DRIVE[n] for n in ("vy", "yaw_rate", "ax", "ay", "steer", "drive")]
    names = "time lat long velocity vy yaw_rate ax ay steer drive"
    rows = "\n".join(
        f"1506{13 + t:06.3f} {60 * a:.8f} {-60 * b:.8f} {3.6 * v:.5f} " + " ".join(f"{x:.9g}" for x in rest)
        for t, a, b, v, *rest in zip(DRIVE["t"], latitude, longitude, DRIVE["vx"], *others, strict=True) if t < 46.9
    )  # fmt: skip
    units = "\n".join(["m/s", "rad/s", "m/s2", "m/s2", "rad", "1"])
    head = f"File created on 09/11/2026\n\n[header]\ntime\n\n[channel units]\n{units}\n\n[column names]\n{names}"
    (tmp_path / "a.vbo").write_text(f"{head}\n\n[data]\n{rows}\n")
    log = read_log(tmp_path / "a.vbo")
    n = len(log)
    assert np.allclose(log["vx"], DRIVE["vx"][:n], atol=1e-4)
    for axis in ("x", "y"):
        moved = log[axis] - log[axis][0] - (DRIVE[axis][:n] - DRIVE[axis][0])
        assert np.abs(moved).max() < 0.01 * np.ptp(DRIVE[axis])
    by_colons = f"\n{rows}\n".replace("\n1506", "\n15:06:")
    (tmp_path / "b.vbo").write_text(f"{head}\n\n[data]{by_colons}")
    assert np.allclose(read_log(tmp_path / "b.vbo")["t"], log["t"], atol=1e-6)


@pytest.mark.parametrize(
    "name",
    ["d01_units_row", "d02_motec", "d03_semicolon", "d07_pandas_index", "d08b_nan", "d09b_ms", "d13_quoted"],
)
def test_logs_of_other_programs_are_the_drive_they_were_made_from(measured_data: Path, name: str) -> None:
    log, truth = (read_log(measured_data / "public" / f"{n}.csv") for n in (name, "d00_ok"))
    for column in set(truth.columns) & set(log.columns) - ({"drive"} if "drive" in log.derived else set()):
        assert np.std(log[column] - truth[column]) < 1e-3 * np.std(truth[column]), column


@pytest.mark.parametrize("text", ["deg/s", "[°/s]", " Degree/s ", "(deg/s)"])
def test_a_unit_has_one_spelling(text: str) -> None:
    assert normal_unit(text) == "deg/s"
