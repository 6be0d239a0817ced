"""Tracks: geometry, smoothing, shipped files, and what is said about broken ones."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil_gateway.config import OriginConfig
from hil_gateway.process.errors import InputError
from hil_gateway.track.csv_file import read_csv
from hil_gateway.track.geodesy import LocalMap
from hil_gateway.track.loading import load_track, shipped_tracks
from hil_gateway.track.track import Track

HEADER = "x_m,y_m,w_tr_right_m,w_tr_left_m"


def _circle(radius: float, n: int, noise: float = 0.0, seed: int = 1) -> list[str]:
    angle = np.arange(n) * 2 * np.pi / n
    scatter = np.random.default_rng(seed).normal(0.0, noise, (2, n)) if noise else np.zeros((2, n))
    x, y = radius * np.cos(angle) + scatter[0], radius * np.sin(angle) + scatter[1]
    return [HEADER, *(f"{a:.4f},{b:.4f},6.0,5.0" for a, b in zip(x, y, strict=True))]


def _load(folder: Path, lines: list[str]) -> Track:
    path = folder / "t.csv"
    path.write_text("\n".join(lines))
    return load_track(path)


def test_circle_has_its_length_curvature_and_heading(tmp_path: Path) -> None:
    track = _load(tmp_path, _circle(100.0, 200))
    assert track.length == pytest.approx(2 * np.pi * 100, rel=1e-4)
    assert track.curvature == pytest.approx(np.full(len(track.s), 0.01), rel=2e-3)
    assert track.at(0.0).heading == pytest.approx(np.pi / 2, abs=1e-3)
    assert track.turning == pytest.approx(2 * np.pi)
    assert track.at(0.0).width_left == pytest.approx(5.0)
    assert track.at(0.0).width_right == pytest.approx(6.0)


def test_a_track_file_is_read_again_when_it_has_changed(tmp_path: Path) -> None:
    first = _load(tmp_path, _circle(100.0, 200))
    assert _load(tmp_path, _circle(120.0, 250)).length == pytest.approx(1.2 * first.length, rel=1e-3)


def test_heading_is_continuous_over_laps(tmp_path: Path) -> None:
    track = _load(tmp_path, _circle(50.0, 100))
    heading = track.at(np.arange(-700.0, 700.0, 1.0)).heading
    assert np.abs(np.diff(heading) - 1.0 / 50.0).max() < 1e-3


@pytest.mark.parametrize("noise", [0.1, 0.3])
@pytest.mark.parametrize("points", [300, 900])
def test_survey_noise_does_not_reach_the_curvature(tmp_path: Path, noise: float, points: int) -> None:
    track = _load(tmp_path, _circle(150.0, points, noise))
    assert (
        np.abs(track.curvature - 1 / 150.0).max() < 2e-3
    )  # as surveyed, it scatters by noise / spacing^2: 0.01 to 0.3
    assert 0.3 * noise < track.deviation < 1.5 * noise


def test_survey_noise_does_not_reach_the_grade(tmp_path: Path) -> None:
    angle = np.arange(300) * 2 * np.pi / 300
    z = 15.0 * np.sin(angle) + np.random.default_rng(2).normal(0.0, 0.2, 300)
    rows = [f"{150 * np.cos(a):.4f},{150 * np.sin(a):.4f},6,6,{h:.4f}" for a, h in zip(angle, z, strict=True)]
    track = _load(tmp_path, [HEADER + ",z_m", *rows])
    assert np.tan(track.grade) == pytest.approx(0.1 * np.cos(track.s / 150.0), abs=0.01)


@settings(max_examples=60, deadline=None)
@given(s=st.floats(0, 3600), lateral=st.floats(-5.5, 5.5), error=st.floats(-30, 30))
def test_projection_inverts_position_on_the_road_course(s: float, lateral: float, error: float) -> None:
    track = load_track()
    p = track.at(s)
    x, y = p.x - lateral * np.sin(p.heading), p.y + lateral * np.cos(p.heading)
    found, offset = track.project(x, y, hint=s + error)
    assert abs((found - s + 0.5 * track.length) % track.length - 0.5 * track.length) < 0.02
    assert offset == pytest.approx(lateral, abs=0.02)


def test_projection_without_hint_searches_the_whole_lap() -> None:
    track = load_track("oval")
    p = track.at(1234.0)
    assert track.project(p.x, p.y) == pytest.approx((1234.0, 0.0), abs=0.01)


def test_road_course_keeps_the_public_facts_of_its_model() -> None:
    track = load_track()
    assert track.length == pytest.approx(3602, rel=0.002)
    assert np.ptp(track.z) == pytest.approx(55.0, abs=1.0)
    assert -100 * np.tan(track.grade.min()) == pytest.approx(18.0, abs=0.5)
    assert np.trapezoid(np.tan(track.grade), track.s) == pytest.approx(0.0, abs=0.2)
    turns = np.flatnonzero(np.diff((np.abs(track.curvature) > 0.01).astype(int)) == 1)
    assert len(turns) >= 9


@pytest.mark.parametrize("name", shipped_tracks())
def test_shipped_tracks_close_and_do_not_cross_themselves(name: str) -> None:
    track = load_track(name)
    ends = track.at(np.array([0.0, track.length - 1e-9]))
    assert np.hypot(*np.diff([ends.x, ends.y], axis=1).ravel()) < 0.01
    left = np.stack([track.x, track.y]) + track.width_left * np.stack([-np.sin(track.heading), np.cos(track.heading)])
    along = np.diff(left, axis=1)
    forward = along[0] * np.cos(track.heading[:-1]) + along[1] * np.sin(track.heading[:-1])
    assert forward.min() > 0  # the inner edge never folds back


def test_measured_tracks_load(measured_tracks: Path) -> None:
    for path in measured_tracks.glob("*.csv"):
        track = load_track(path)
        assert track.deviation < 0.1
        assert np.abs(track.curvature).max() < 0.08


BROKEN = {
    "missing column": (lambda lines: ["x_m,y_m,w_tr_right_m", *lines[1:]], r"t\.csv:1: column w_tr_left_m is missing"),
    "text": (lambda lines: [*lines[:5], "1,abc,5,5", *lines[6:]], r"t\.csv:6: y_m = 'abc' is not a number"),
    "nan": (lambda lines: [*lines[:5], "nan,1.0,5,5", *lines[6:]], r"t\.csv:6: x_m = nan is outside"),
    "width": (lambda lines: [*lines[:9], "1.0,1.0,-5,5", *lines[10:]], r"t\.csv:10: w_tr_right_m = -5 is outside"),
    "short row": (lambda lines: [*lines[:9], "1.0,1.0", *lines[10:]], r"t\.csv:10: 2 values, the header names 4"),
    "too few": (lambda lines: lines[:6], r"5 different points; a track needs at least 12"),
    "open": (lambda lines: lines[:120], r"t\.csv:120: the track is not closed: 1\d\d\.\d m"),
    "shuffled": (lambda lines: [*lines[:60], *lines[100:150], *lines[60:100], *lines[150:]], r"m to the next point"),
    "column twice": (
        lambda lines: [lines[0] + ",x_m", *(f"{line},0" for line in lines[1:])],
        r"t\.csv:1: column x_m is there twice",
    ),
    "heights": (
        lambda lines: [lines[0] + ",z_m", *(f"{line},{1000 * (i % 2)}" for i, line in enumerate(lines[1:]))],
        r"t\.csv:2: z_m changes by 1000\.0 m over",
    ),
    "empty": (lambda lines: [], r"column x_m is missing"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_file_is_explained(tmp_path: Path, case: str) -> None:
    change, message = BROKEN[case]
    with pytest.raises(InputError, match=message):
        _load(tmp_path, change(_circle(100.0, 200)))


def test_unknown_track_lists_the_shipped_ones(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no such track file; shipped tracks: oval, road_course"):
        load_track(tmp_path / "none.csv")


LAYOUT_ERRORS = {
    "turns": ("[[segment]]\nstraight=100\n[[segment]]\ncorner=90\nradius=50\n", "turn by 90 deg in all"),
    "both": ("[[segment]]\nstraight=100\ncorner=90\n[[segment]]\nstraight=1\n", "segment 1: give either"),
    "unknown key": ("[[segment]]\nlenght=100\n[[segment]]\nstraight=1\n", "segment.0.lenght"),
    "open": ("[[segment]]\nstraight=100\n[[segment]]\ncorner=360\nradius=50\n", "corner = 360"),
    "no straight": ("[[segment]]\ncorner=180\nradius=50\n[[segment]]\ncorner=180\nradius=90\n", "does not close"),
}


@pytest.mark.parametrize("case", LAYOUT_ERRORS)
def test_broken_description_is_explained(tmp_path: Path, case: str) -> None:
    text, message = LAYOUT_ERRORS[case]
    path = tmp_path / "t.toml"
    path.write_text(f'name = "t"\n{text}')
    with pytest.raises(InputError, match=message):
        load_track(path)


def _with_lane(folder: Path, lateral: list[float]) -> Track:
    """A circle of 100 m, driven to the left, with a lane `lateral` m inside of its line over its first half."""
    angle = np.linspace(-0.5, 2.0, len(lateral))
    radius = 100.0 - np.array(lateral)
    rows = [f"{r * np.cos(a):.4f},{r * np.sin(a):.4f},4.0,3.0" for a, r in zip(angle, radius, strict=True)]
    (folder / "t.pit.csv").write_text("\n".join([HEADER, *rows]))
    return _load(folder, _circle(100.0, 200))


def test_a_pit_lane_beside_a_track_file_lies_where_its_points_are(tmp_path: Path) -> None:
    track = _with_lane(tmp_path, [3.0, 12.0, 15.0, 15.0, 15.0, 12.0, 3.0])
    assert track.pit_lane is not None
    half_way = 100.0 * 0.75
    room = track.room(half_way, 15.0)
    assert room.in_lane
    assert (room.left, room.right) == pytest.approx((3.0, 4.0), abs=0.1)
    assert track.room(half_way, 0.0)[:2] == pytest.approx((5.0, 6.0), abs=0.05)
    assert track.inside(half_way, 8.0) == pytest.approx(-3.0, abs=0.1), "between road (5) and lane (11)"
    assert track.inside(400.0, 15.0) == pytest.approx(-10.0, abs=0.1), "no lane there"
    touching = track.room(track.length - 49.0, 4.0)
    assert not touching.in_lane
    assert touching.right == pytest.approx(10.0, abs=0.1)
    assert touching.left > 1.5


@pytest.mark.parametrize("name", sorted(shipped_tracks()))
def test_what_holds_a_car_is_what_it_is_inside_of(name: str) -> None:
    track = load_track(name)
    for s in np.linspace(0.0, track.length, 60, endpoint=False).tolist():
        for lateral in np.linspace(-25.0, 25.0, 41).tolist():
            beyond = track.inside(s, lateral) - 0.5
            assert track.holds(s, lateral, 0.5) == (beyond > 0.0) or abs(beyond) < 0.1, (s, lateral)
    assert not track.holds(0.0, math.nan, 0.5)


def test_a_pit_lane_changes_nothing_of_the_track_and_is_read_again_when_it_changes(tmp_path: Path) -> None:
    bare = _load(tmp_path, _circle(100.0, 200))
    assert bare.pit_lane is None
    track = _with_lane(tmp_path, [3.0, 14.0, 14.0, 3.0])
    np.testing.assert_array_equal(track.x, bare.x)
    assert track.pit_lane is not None
    assert track.pit_lane.offset.max() == pytest.approx(14.0, abs=0.1)


@pytest.mark.parametrize(
    ("lateral", "said"),
    [([12.0, 14.0, 14.0, 3.0], "entry is 3.0 m from"), ([3.0, 14.0, 14.0, 20.0], "exit is 11.0 m from")],
)
def test_a_pit_lane_that_does_not_touch_the_road_is_refused(tmp_path: Path, lateral: list[float], said: str) -> None:
    with pytest.raises(InputError, match=said) as error:
        _with_lane(tmp_path, lateral)
    assert "t.pit.csv" in str(error.value)


def test_a_pit_lane_against_the_track_is_refused(tmp_path: Path) -> None:
    _with_lane(tmp_path, [3.0, 12.0, 12.0, 3.0])
    lane = tmp_path / "t.pit.csv"
    header, *rows = lane.read_text().splitlines()
    lane.write_text("\n".join([header, *rows[::-1]]))
    with pytest.raises(InputError, match="driving order"):
        load_track(tmp_path / "t.csv")


def _with_boxes(folder: Path, box: str, speeds: tuple[float, ...] = (0.0, 15.0, 15.0, 15.0, 0.0)) -> Track:
    """As `_with_lane`, 15 m inside of the line, with a speed limit and one box."""
    _with_lane(folder, [3.0, 15.0, 15.0, 15.0, 3.0])
    header, *rows = (folder / "t.pit.csv").read_text().splitlines()
    limited = [f"{row},{speed}" for row, speed in zip(rows, speeds, strict=True)]
    (folder / "t.pit.csv").write_text("\n".join([f"{header},speed_mps", *limited]))
    (folder / "t.boxes.csv").write_text(f"x_m,y_m,heading_rad\n{box}")
    return load_track(folder / "t.csv")


def test_speed_limit_and_boxes_of_a_pit_lane_lie_where_the_files_say(tmp_path: Path) -> None:
    angle = 0.75
    x, y, yaw = 84.0 * np.cos(angle), 84.0 * np.sin(angle), angle + 0.5 * np.pi + 0.1
    track = _with_boxes(tmp_path, f"{x:.4f},{y:.4f},{yaw:.4f}")
    lane = track.pit_lane
    assert lane is not None
    assert lane.speed == 15.0
    begin, end = (track.at(s) for s in lane.limit)
    assert np.arctan2([begin.y, end.y], [begin.x, end.x]) == pytest.approx([0.125, 1.375], abs=0.01)
    (box,) = lane.boxes
    assert (box.offset, box.across) == pytest.approx((16.0, 0.1), abs=0.05)
    found = track.box_pose(box)
    assert found[:2] == pytest.approx((x, y), abs=0.01)
    assert np.angle(np.exp(1j * (found[2] - yaw))) == pytest.approx(0.0, abs=0.001)


@pytest.mark.parametrize(
    ("box", "speeds", "said"),
    [
        ("-85,0,4.71", (0.0, 15.0, 15.0, 15.0, 0.0), "box 1 is at 314 m"),
        ("66.0,61.0,2.32", (0.0, 15.0, 15.0, 15.0, 0.0), "box 1 is 0.9 m beside"),
        ("61.5,57.3,-0.82", (0.0, 15.0, 15.0, 15.0, 0.0), "box 1 is turned by -180"),
        ("61.5,57.3,2.32", (0.0, 15.0, 12.0, 15.0, 0.0), "speed_mps = 12 where it was 15"),
        ("61.5,57.3,2.32", (0.0, 70.0, 70.0, 70.0, 0.0), "pit speed 70 m/s is outside 3 to 40"),
        ("61.5,57.3,2.32", (0.0, 0.0, 15.0, 0.0, 0.0), "the pit speed holds from"),
    ],
)
def test_a_pit_lane_whose_boxes_or_limit_cannot_be_is_refused(
    tmp_path: Path, box: str, speeds: tuple[float, ...], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        _with_boxes(tmp_path, box, speeds)


@pytest.mark.parametrize("name", sorted(shipped_tracks()))
def test_shipped_pit_lanes_begin_and_end_on_the_road_and_lie_beside_it(name: str) -> None:
    track = load_track(name)
    lane = track.pit_lane
    assert lane is not None
    beside = track.room(lane.s, lane.offset)
    assert not beside.in_lane[0]
    assert not beside.in_lane[-1]
    assert beside.in_lane.mean() > 0.4
    assert min(beside.left.min(), beside.right.min()) > 2.0


@pytest.mark.parametrize(("separator", "decimal"), [(";", "."), (";", ","), ("\t", ",")])
def test_other_separators_and_decimal_commas_give_the_same_track(tmp_path: Path, separator: str, decimal: str) -> None:
    rows = _circle(100.0, 200)
    first = _load(tmp_path, rows)
    other = [row.replace(",", separator).replace(".", decimal) for row in rows]
    (tmp_path / "u.csv").write_text("\n".join(other))
    assert np.array_equal(load_track(tmp_path / "u.csv").x, first.x)


def test_places_by_latitude_and_longitude_are_metres_from_the_first(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A degree of latitude is 111.2 km at 48 degrees north, one of longitude 74.5 km (WGS 84 tables)."""
    turn = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    places = zip(48.0 + 3e-4 * np.sin(turn), 11.0 + 6e-4 * np.cos(turn), strict=True)
    rows = "".join(f"{lat:.9f},{lon:.9f},1.1,1.2\n" for lat, lon in places)
    (tmp_path / "t.csv").write_text("latitude,longitude,w_tr_right_m,w_tr_left_m\n" + rows)
    survey = read_csv(tmp_path / "t.csv")
    assert np.ptp(survey.y) == pytest.approx(6e-4 * 111_200, rel=2e-3)
    assert np.ptp(survey.x) == pytest.approx(12e-4 * 74_500, rel=2e-3)
    assert (survey.x[0], survey.y[0]) == (0.0, 0.0)
    assert "the car's origin has to be there" in caplog.text


def test_a_lane_by_latitude_and_longitude_lies_where_the_same_lane_in_metres_does(tmp_path: Path) -> None:
    """Also with names in capitals; a lane in another form than its track is refused for that."""
    metres = _with_lane(tmp_path, [3.0, 12.0, 15.0, 15.0, 15.0, 12.0, 3.0])
    to_degrees, widths = LocalMap(OriginConfig(latitude=39.8, longitude=-86.2)).to_geodetic, HEADER.split(",")[2:]
    for name in ("t.csv", "t.pit.csv"):
        if name == "t.pit.csv":
            with pytest.raises(InputError, match="another form than the track's"):
                load_track(tmp_path / "t.csv")
        rows = [line.split(",") for line in (tmp_path / name).read_text().splitlines()[1:]]
        degrees = [(*(f"{a:.10f}" for a in to_degrees(float(x), float(y))), *rest) for x, y, *rest in rows]
        text = "\n".join(",".join(row) for row in [("Latitude", "LON", *widths), *degrees])
        (tmp_path / name).write_text(text)
    assert metres.pit_lane is not None
    lane = load_track(tmp_path / "t.csv").pit_lane
    assert lane is not None
    assert lane.offset == pytest.approx(metres.pit_lane.offset, abs=0.02)


def test_places_in_degrees_without_widths_are_told_that_widths_are_missing(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("lat,lon\n48.0,11.0\n")
    with pytest.raises(InputError, match="w_tr_right_m is missing"):
        read_csv(tmp_path / "t.csv")


def test_places_on_a_utm_grid_are_moved_and_that_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    rows = [HEADER]
    for row in _circle(100.0, 200)[1:]:
        x, y, widths = row.split(",", 2)
        rows.append(f"{float(x) + 691_234.5:.4f},{float(y) + 5_334_567.25:.4f},{widths}")
    track = _load(tmp_path, rows)
    assert track.length == pytest.approx(2 * np.pi * 100, rel=1e-4)
    assert np.abs(track.x).max() < 1000.0
    assert "moved by -691000, -5335000 m" in caplog.text


def test_a_track_of_model_cars_keeps_its_line(tmp_path: Path) -> None:
    """Bends of 1.6 m radius, 2.2 m wide: a stadium of two half circles."""
    n, radius, straight = 120, 1.6, 6.0
    s = np.linspace(0.0, 2 * straight + 2 * np.pi * radius, n, endpoint=False)
    half = straight + np.pi * radius
    angle = np.clip(s % half - straight, 0.0, None) / radius
    along = np.minimum(s % half, straight) + radius * np.sin(angle)
    across = radius * (1.0 - np.cos(angle)) - radius
    z = (along - straight / 2 + 1j * across) * np.where(s >= half, -1.0, 1.0)
    track = _load(tmp_path, [HEADER, *(f"{p.real:.4f},{p.imag:.4f},1.1,1.1" for p in z)])
    assert track.length == pytest.approx(s[-1] + s[1], rel=0.03)
    assert track.deviation < 0.1
    assert np.abs(track.curvature).max() == pytest.approx(1 / radius, rel=0.35)
