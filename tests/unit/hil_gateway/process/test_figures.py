"""Numbers people read are rounded and have a unit; numbers programs read are whole, in JSON's own types."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from hil_gateway.process.figures import compared, figure, lap_time, lines, plain, print_json


def test_a_lap_is_shown_as_fine_as_it_is_timed():
    """By the estimate to 0.01 s: two ways to time one lap differ by some ms."""
    assert [lap_time(time_s) for time_s in (93.0388, 93.0421, 123.0, None)] == ["93.04 s", "93.04 s", "123.00 s", "-"]


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (54.120000000000005, "s", "54.12 s"),
        (-0.0, "deg", "0 deg"),
        ([np.float64(100.02420961316162)], "s", "100 s"),
        ([np.float64(88.51), 91.0], "s", "88.51, 91 s"),
        ([], "s", "none"),
        (None, "ms", "-"),
        (float("nan"), "m", "-"),
        (float("inf"), "m", "-"),
        (np.int64(3), "", "3"),
        (12345678, "", "12345678"),
        (123456.7, "N", "123500 N"),
        (2.3e-5, "", "2.3e-05"),
        (1.23456e7, "", "1.235e+07"),
        (0.0, "m", "0 m"),
        (-0.04999, "rad", "-0.04999 rad"),
        (np.bool_(True), "", "yes"),
        ("hpipm", "", "hpipm"),
    ],
)
def test_a_figure_is_rounded_and_has_its_unit(value: Any, unit: str, text: str) -> None:
    assert figure(value, unit) == text


@pytest.mark.parametrize(
    ("ratio", "text"),
    [
        (2.24, "2.2 times fewer"), (1.0, "as many"), (1.04, "as many"), (0.97, "as many"), (0.5, "2 times more"),
        (None, "an unknown number of times fewer"), (float("inf"), "an unknown number of times fewer"),
    ],
)  # fmt: skip
def test_a_ratio_of_one_is_not_called_fewer(ratio: float | None, text: str) -> None:
    assert compared(ratio, "fewer", "more") == text


def test_tables_of_figures_have_no_trace_of_python() -> None:
    tree = {
        "places": 24,
        "seconds": 2.0,
        "cases": {"plain": {"iterations": {"median": np.float64(0.3), "samples": 115}}},
        "lap_times_s": [np.float64(100.02420961316162)],
        "solve_ms": {"p50": 4.123456, "p99": np.float64(9.87654), "samples": 9},
        "information_per_s": 12.3456,
        "fast": True,
    }
    text = "\n".join(lines(tree))
    assert not set("{}[]'_") & set(text)
    assert "np.float" not in text
    assert "lap times    100 s" in text
    assert "p50 4.123 ms, p99 9.877 ms, samples 9" in text
    assert "information  12.35 1/s" in text
    assert "median 0.3, samples 115" in text


def test_json_keeps_every_digit_and_has_no_word_json_does_not_know(capsys: pytest.CaptureFixture[str]) -> None:
    numbers = {"t": np.float64(54.120000000000005), "n": np.int64(3), "a": np.arange(3), "nan": float("nan")}
    print_json({**numbers, 1: {2.5}})
    text = capsys.readouterr().out
    assert json.loads(text, parse_constant=pytest.fail) == {
        "t": 54.120000000000005, "n": 3, "a": [0, 1, 2], "nan": None, "1": [2.5],
    }  # fmt: skip
    with pytest.raises(TypeError, match="no JSON type"):
        plain(object())
