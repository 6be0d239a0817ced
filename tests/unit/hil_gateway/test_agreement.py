"""Processes that drive one car agree on track and car, or it is not armed and the one that differs is named."""

from __future__ import annotations

import shutil
from pathlib import Path

from can_dbc.folder import SHIPPED
from hil_gateway.agreement import agreement, disagreement
from hil_gateway.bus import topics
from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.messages import GatewayStatus
from hil_gateway.config import Config
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track
from planner.node import Planner
from planner.simulation.loop import Loop


def test_the_same_track_and_car_agree() -> None:
    config = Config()
    ours = agreement(config, load_track(config.track))
    assert disagreement(ours, "planner", agreement(Config(), load_track(config.track))) == ""
    assert disagreement(ours, "planner", None) == "", "who says nothing is not compared"


def copied_car(folder: Path, mass: str) -> Config:
    shutil.copytree(SHIPPED / "av24", folder)
    file = folder / "car.toml"
    file.write_text(file.read_text().replace("mass = { value = 787.3", f"mass = {{ value = {mass}"))
    return Config(platform=str(folder))


def test_another_track_and_a_changed_car_are_named(tmp_path: Path) -> None:
    ours, oval = agreement(Config(), load_track("")), load_track("oval")
    said = disagreement(ours, "estimator", agreement(copied_car(tmp_path / "same" / "av24", "787.3"), oval))
    assert said.startswith("estimator: track oval ")
    assert "car" not in said, "a copy of the folder is the same car"
    changed = agreement(copied_car(tmp_path / "heavier" / "av24", "797.3"), load_track(""))
    assert disagreement(ours, "estimator", changed).startswith("estimator: car av24 ")


def test_a_planner_on_another_track_is_named_and_the_car_is_not_armed() -> None:
    def planner(config: Config, bus: LocalBus, _: Track) -> Planner:
        return Planner(config, bus, load_track("tri_oval"), stopwatch=lambda: 0)

    loop = Loop(
        Config(track="oval", planner={"horizon": 20}), components={"planner": planner}, keep=[topics.GATEWAY_STATUS]
    )
    result = loop.run(seconds=1.0, time_limit_s=8.0)
    newest = result.messages[topics.GATEWAY_STATUS.key][-1]
    assert isinstance(newest, GatewayStatus)
    assert not result.armed
    assert "disagreement" in newest.missing_for_arming
    assert newest.advice["disagreement"].startswith("planner: track tri_oval ")
