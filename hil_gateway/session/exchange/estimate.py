"""`hil session import --estimate`: a log of another program becomes a session that can be identified and diagnosed."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from hil_gateway.config import load_config
from hil_gateway.process.children import ask
from hil_gateway.process.errors import InputError
from hil_gateway.session.exchange.importer import import_log
from hil_gateway.session.exchange.perceive import perceive


def import_and_estimate(
    source: Path, target: Path, channel: str | None, config_file: Path | None
) -> tuple[dict[str, Any], str]:
    """Frames -> vehicle states (gateway) -> estimates (estimator, by its own command); what to report, and in words.

    Raises:
        InputError: unreadable log or configuration, frames of no car, an estimator that fails.
    """
    config = load_config(config_file)
    with tempfile.TemporaryDirectory(dir=target.resolve().parent, prefix=".import-") as folder:
        frames, states = Path(folder) / "frames.mcap", Path(folder) / "states.mcap"
        done = import_log(source, frames, config.car, channel)
        left_out, notes = dict(done.left_out), done.notes
        seen = perceive(frames, states, config)
        missing = sorted(seen.never_heard)
        if not seen.valid:
            reason = f"none of {seen.states} vehicle states is valid; never heard: {', '.join(missing) or '-'}"
            raise InputError(f"{source}: {reason}; is it a log of this --platform, and of the right --channel?")
        answer = ask(["estimator", "estimate", str(states), "--out", str(target)])
        if answer.reason:
            raise InputError(f"{source}: {answer.reason}")
    counts = answer.content["counts"]
    values = {
        "path": str(target), "left_out": left_out, "notes": notes,
        "vehicle_states": seen.states, "valid_states": seen.valid,
        "estimates": counts["av24/estimate"], "valid_estimates": counts["valid"], "never_heard": missing,
    }  # fmt: skip
    text = f"{counts['valid']} of {counts['av24/estimate']} estimates valid, written to {target}"
    return values, f"{text}; never in the log: {', '.join(missing)}" if missing else text
