"""A track as a page: what its file says, drawn and in figures."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hil_gateway.cli.track_day.track import app
from hil_gateway.process.errors import InputError
from hil_gateway.track.loading import shipped_tracks

RADIUS_M, WIDTHS_M = 100.0, (4.0, 7.0)


@pytest.fixture
def circle(tmp_path: Path) -> Path:
    """Driven clockwise, 4 m to the right and 7 m to the left, level."""
    path = tmp_path / "circle.csv"
    angles = [-2.0 * math.pi * i / 200 for i in range(200)]
    rows = [f"{RADIUS_M * math.cos(a):.4f},{RADIUS_M * math.sin(a):.4f},4,7" for a in angles]
    path.write_text("\n".join(["x_m,y_m,w_tr_right_m,w_tr_left_m", *rows]) + "\n")
    return path


def drawn(track: str, out: Path) -> str:
    result = CliRunner().invoke(app, ["view", track, "--out", str(out)], catch_exceptions=False)
    assert result.exit_code == 0
    return out.read_text()


def test_the_figures_are_those_of_the_file(circle: Path, tmp_path: Path) -> None:
    page = drawn(str(circle), tmp_path / "page.html")
    assert "628.3" in page and " m, driven clockwise" in page
    assert "<td>11 m</td>" in page and "<td>100 m at" in page and "<td>0 deg</td>" in page
    assert "Pit lane" not in page and page.count("<svg") == 2


@pytest.mark.parametrize("name", shipped_tracks())
def test_every_shipped_track_is_drawn_with_its_pit_lane_and_loads_nothing(name: str, tmp_path: Path) -> None:
    page = drawn(name, tmp_path / "page.html")
    assert "Pit lane" in page and "1 at " in page and page.count("<svg") + page.count("<img") == 3
    assert "src=" not in page.replace('src="data:', "") and "<link" not in page


def test_a_track_that_is_not_there_is_named_and_nothing_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such track file"):
        CliRunner().invoke(app, ["view", "nowhere", "--out", str(tmp_path / "page.html")], catch_exceptions=False)
    assert list(tmp_path.iterdir()) == []
