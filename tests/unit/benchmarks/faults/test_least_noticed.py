"""The least error that is noticed, searched among sizes."""

from __future__ import annotations

from typing import cast

import pytest

from benchmarks.faults.car_campaign import Run
from benchmarks.faults.car_faults import CarFault, Memory
from benchmarks.faults.least_noticed import ERRORS, SIZES, STEP, least_noticed, main
from hil_gateway.process.errors import InputError


class Noticing:
    """A gateway that notices a yaw rate off by so much, and says so after a tenth of a second."""

    def __init__(self, bound: float) -> None:
        self._bound = bound

    def noticed(self, fault: CarFault, within_s: float) -> tuple[float | None, str]:
        assert fault.alter is not None
        altered = fault.alter({"imu_yaw_rate": 0.0}, cast("Memory", None))
        assert altered is not None
        return (0.1, "yaw_rate_wrong") if altered["imu_yaw_rate"] >= self._bound else (None, "")


@pytest.mark.parametrize("bound", [0.0, 0.03, 0.1])
def test_the_least_size_is_the_first_above_the_bound(bound: float) -> None:
    found = least_noticed(cast("Run", Noticing(bound)), ERRORS[0])
    assert found.size is not None
    assert bound <= found.size < max(STEP * bound, 1.01 * ERRORS[0].smallest)
    assert (found.after_s, found.cause) == (0.1, "yaw_rate_wrong")


def test_what_is_never_noticed_has_no_size() -> None:
    found = least_noticed(cast("Run", Noticing(ERRORS[0].sizes[SIZES - 1] * 1.01)), ERRORS[0])
    assert (found.size, found.after_s) == (None, None)


@pytest.mark.parametrize("arguments", [[], ["one"], ["-1"], ["1", "no_such_track"]])
def test_arguments_that_are_wrong_are_refused_before_anything_is_driven(arguments: list[str]) -> None:
    with pytest.raises(InputError):
        main(arguments)
