"""The law of the brake balance against axle loads worked out by hand."""

from __future__ import annotations

from itertools import product

import pytest

from hil_gateway.car.car import load_car
from planner.problem.brake_law import BrakeLaw, pressure_ratio

GRAVITY = 9.80665
CAR, TRAIN = load_car().vehicle, load_car().powertrain
GRIPS = ((1.3, 1.3), (1.2, 1.35), (1.4, 1.3))
SHARES = (0.46, 0.5, 0.54)


def _used(vx: float, braking: float, grip: tuple[float, float], share: float, extra: float) -> tuple[float, float]:
    """Force over what the tyres bear (front, rear) when `braking` N are split by the law where the road adds `extra`
    to the axle loads, over the weight."""
    balance = float(
        BrakeLaw(load_car().vehicle, load_car().powertrain).balance(
            vx, -braking / TRAIN.force_per_drive, pressure_ratio(grip, share), extra
        )
    )
    front, rear = (1 + balance) * share, (1 - balance) * (1 - share)
    moved = 0.275 * braking / (1.724 + 1.248)
    load_f = (1 + extra) * 787.3 * GRAVITY * 1.248 / 2.972 + 0.5 * 1.2 * 0.65 * vx**2 + moved
    load_r = (1 + extra) * 787.3 * GRAVITY * 1.724 / 2.972 + 0.5 * 1.2 * 1.18 * vx**2 - moved
    part = braking / (front + rear)
    return front * part / (grip[0] * load_f), rear * part / (grip[1] * load_r)


@pytest.mark.parametrize(("grip", "share"), list(product(GRIPS, SHARES)))
@pytest.mark.parametrize("extra", [-0.5, 0.0, 0.3])
def test_the_front_axle_reaches_its_limit_first_and_the_rear_one_close_behind_on_crests_too(grip, share, extra):
    low, high = TRAIN.balances
    for vx, g in ((20.0, 1.2), (45.0, 1.5), (70.0, 1.9)):
        force = 787.3 * 9.81 * (g + extra)
        balance = float(
            BrakeLaw(load_car().vehicle, load_car().powertrain).balance(
                vx, -force / TRAIN.force_per_drive, pressure_ratio(grip, share), extra
            )
        )
        front, rear = _used(vx, force, grip, share, extra)
        if low < balance < high:
            assert front / rear == pytest.approx(1.1, rel=1e-6)
        else:
            assert balance in {low, high}


def test_braking_harder_and_slower_asks_for_more_in_front():
    law = BrakeLaw(load_car().vehicle, load_car().powertrain)
    balances = [float(law.balance(vx, drive, 1.0, 0.0)) for vx, drive in ((70.0, -0.1), (70.0, -0.3), (20.0, -0.3))]
    assert balances[0] < balances[1] < balances[2]


def test_no_law_leaves_an_axle_without_brakes():
    """Whatever car is declared and whatever is believed."""
    high_car = CAR.model_copy(update={"cg_height": 2.0, "lf": 0.5, "lr": 3.5})
    for car, ratio, vx, extra in product((CAR, high_car), (1e-3, 1.0, 1e3), (0.0, 90.0), (-0.8, 0.0, 2.0)):
        balance = float(BrakeLaw(car, TRAIN).balance(vx, -0.4, ratio, extra))
        assert TRAIN.balances[0] - 1e-12 <= balance <= TRAIN.balances[1] + 1e-12
