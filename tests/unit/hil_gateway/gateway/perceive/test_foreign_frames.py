"""Frames that only the computer sends, from somebody else."""

from __future__ import annotations

import pytest

from can_dbc.codec import load_codec
from hil_gateway.can_link import Frame
from hil_gateway.car.actuation import Actuation
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.vehicle_state import VehicleStateBuilder

CONFIG, CODEC = Config(), load_codec()


@pytest.mark.parametrize("name", ["brake_pressure_cmd", "accelerator_cmd", "steering_cmd", "gear_shift_cmd"])
def test_a_command_of_another_computer_counts_at_any_length(name: str) -> None:
    layout = CODEC.messages[name]
    for length in range(9):
        builder = VehicleStateBuilder(CONFIG, Actuation(CONFIG.vehicle, CONFIG.powertrain))
        builder.take([Frame(layout.id, bytes(length), 1)], 1)
        assert builder.another("commands", 1)
        assert builder.counts.malformed == (length != layout.dlc)
