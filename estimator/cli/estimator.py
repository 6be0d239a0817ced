"""`hil estimator`: the estimator process, its score on a session, its replay, and what it makes of states."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from hil_gateway.cli.groups import process_app
from hil_gateway.config import load_config
from hil_gateway.process.errors import EXIT_FAILURE
from hil_gateway.process.figures import figure, print_json

app = process_app(
    "estimator", "estimator.node", "State, tyre belief and model revisions.",
    "Estimate the state, learn the tyres, publish model revisions until interrupted.",
)  # fmt: skip


@app.command()
def score(
    session: Annotated[Path, typer.Argument(help="a recorded .mcap file")],
    config: Annotated[Path | None, typer.Option(help="configuration (TOML)")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="one JSON object on standard output")] = False,
) -> None:
    """Prediction error over one second: of the first and of the learnt model of the session."""
    from estimator.offline.result.model_score import score_session

    result = score_session(session, load_config(config))
    if as_json:
        print_json(result)
        return
    for channel, error in result["before"].items():
        print(f"{channel:10} {figure(error)} -> {figure(result['after'][channel])}")


@app.command()
def replay(
    session: Annotated[Path, typer.Argument(help="a recorded .mcap file")],
    as_json: Annotated[bool, typer.Option("--json", help="one JSON object on standard output")] = False,
) -> None:
    """Replay a session through the estimator; exit 1 unless it gives the recorded outputs byte for byte."""
    from estimator.replay import compare, replay_estimator
    from hil_gateway.session.files.configuration import required_config

    result = compare(session, replay_estimator(session, required_config(session)))
    if as_json:
        print_json({key: asdict(row) for key, row in result.items()})
    else:
        print("\n".join(f"{key:22} {row.identical} of {row.recorded} identical" for key, row in result.items()))
    if any(row.identical < row.recorded for row in result.values()):
        raise typer.Exit(EXIT_FAILURE)


@app.command()
def estimate(
    session: Annotated[Path, typer.Argument(help="a recorded .mcap file with vehicle states")],
    out: Annotated[Path, typer.Option(help="session to write")],
    config: Annotated[Path | None, typer.Option(help="configuration (TOML; default: the recorded one)")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="one JSON object on standard output")] = False,
) -> None:
    """Write a session with what the estimator makes of the recorded vehicle states."""
    from estimator.estimate_session import estimate_session
    from hil_gateway.session.files.configuration import required_config

    count = estimate_session(session, out, load_config(config) if config else required_config(session))
    if as_json:
        print_json({"counts": count, "path": str(out)})
    else:
        print("\n".join(f"{key:22} {number}" for key, number in count.items()))
