"""`hil ros2`: the bridge to ROS 2 as a process of its own, and the table of its topics."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(no_args_is_help=True, help="Bridge to ROS 2 in the wire format of rmw_zenoh; no ROS installation.")
ConfigFile = Annotated[Path | None, typer.Option("--config", help="configuration (TOML)")]


@app.command()
def run(
    config: ConfigFile = None,
    mode: Annotated[str, typer.Option(help="peer, client or router, in place of ros2.mode")] = "",
    commands: Annotated[str, typer.Option(help="none, raptor or ackermann, in place of ros2.commands")] = "",
) -> None:
    """Pass the car's state to ROS, and a team's commands to the gateway, until stopped."""
    from hil_gateway.config import load_config
    from hil_gateway.ros2.node import run as run_bridge

    given = {"ros2.mode": mode, "ros2.commands": commands}
    run_bridge(load_config(config, {key: value for key, value in given.items() if value}))


@app.command()
def topics(config: ConfigFile = None) -> None:
    """List what appears in ROS, with type and hash."""
    from hil_gateway.config import load_config
    from hil_gateway.ros2.bridge import published_topics, taken_topics
    from hil_gateway.ros2.types import Types

    settings = load_config(config)
    types = Types(settings.ros2.messages, hashes=settings.ros2.type_hashes)
    rows = [("out", t) for t in published_topics(settings)] + [("in", t) for t in taken_topics(settings)]
    names, kinds = (max(map(len, column)) for column in zip(*((t.name, t.type) for _, t in rows), strict=True))
    for way, topic in rows:
        typer.echo(f"{way:3} {topic.name:{names}} {topic.type:{kinds}} {types.of(topic.type).hash}")
