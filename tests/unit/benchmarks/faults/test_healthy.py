"""Effects dealt to cars that drive without a fault."""

from __future__ import annotations

from itertools import combinations

from benchmarks.faults.healthy import LEAST_SIZE, WITHOUT, deal
from hil_gateway.plant.physics.effects import SWITCHES


def test_a_round_of_cars_has_every_effect_and_every_two_of_them_once() -> None:
    pairs = {frozenset(pair) for pair in combinations(SWITCHES, 2)}
    cars = [frozenset(deal(seed)) for seed in range(WITHOUT + len(SWITCHES) + len(pairs))]
    assert cars.count(frozenset()) == WITHOUT
    assert set(cars) == {frozenset()} | {frozenset({name}) for name in SWITCHES} | pairs


def test_a_size_is_one_that_the_effect_may_have_and_that_shows() -> None:
    for seed in range(400):
        for name, size in deal(seed).items():
            switch = SWITCHES[name]
            assert switch.low <= size <= switch.high
            assert abs(size) >= LEAST_SIZE * min(abs(switch.example), abs(switch.low) or abs(switch.example))
