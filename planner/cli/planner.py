"""`hil planner run`: the planner process."""

from __future__ import annotations

from hil_gateway.cli.groups import process_app

app = process_app(
    "planner", "planner.process", "Infomax MPCC: plans and commands.",
    "Plan from the newest estimate and send commands until interrupted.",
)  # fmt: skip
