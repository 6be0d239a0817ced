"""Options that several commands of the laboratory have."""

from __future__ import annotations

import os
from typing import Annotated

import typer

FirstSeed = Annotated[int, typer.Option(min=0, help="number of the first car")]
Track = Annotated[str, typer.Option(help="track file or name of a shipped track")]
Tracks = Annotated[str, typer.Option(help="track files or names of shipped tracks, comma-separated")]
Methods = Annotated[str, typer.Option(help="ways of driving, comma-separated; plain is always among them")]
LapsOfDrive = Annotated[int, typer.Option(min=1, help="laps of every drive")]
Scheduler = Annotated[str, typer.Option(help="address of a dask scheduler to drive on; empty: this machine")]
Processes = Annotated[int, typer.Option(min=1, help="drives at a time")]
AsJson = Annotated[bool, typer.Option("--json", help="summary as one JSON object on standard output")]
CORES = os.cpu_count() or 1
