"""Quantiles of the newest numbers."""

from __future__ import annotations

import random

from hil_gateway.gateway.reporter import Rolling


def test_quantiles_are_those_of_the_newest_numbers() -> None:
    rng, rolling, numbers = random.Random(1), Rolling(100), []
    assert rolling.quantile(0.5) is None
    for _ in range(1000):
        numbers.append(rng.choice((rng.random(), 0.25)))  # equal ones too
        rolling.add(numbers[-1])
        newest = sorted(numbers[-100:])
        assert rolling.quantile(0.5) == newest[len(newest) // 2]
        assert rolling.quantile(0.99) == newest[int(0.99 * len(newest))]
        assert rolling.quantile(1.0) == newest[-1]
