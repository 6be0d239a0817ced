"""The report of a run: one JSON object, or lines for a person."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from hil_gateway.demo.options import DemoOptions, DemoSetup
from hil_gateway.demo.run import Ending, RunResult
from hil_gateway.plant.referee.lap_limit import lap_ratios
from hil_gateway.process.figures import figure


def summarise(
    options: DemoOptions, setup: DemoSetup, result: RunResult, error: dict[str, Any], limit_s: float | None = None
) -> dict[str, Any]:
    """Summary of a run, with the model error measured on its recording and the car's own limit, s."""
    recorder, zero_ns = result.monitor.recorder, result.zero_ns
    return {
        **_driven(result, limit_s),
        **_reported(result),
        "failsafes": [asdict(failsafe) for failsafe in result.monitor.failsafes],
        "model_error": error,
        "bus": setup.bus,
        "session": str(setup.session),
        "recorder": recorder.model_dump(include={"frames", "messages", "lost", "errors", "last_error"})
        if recorder
        else {},
        "cpu": {name: round(share, 3) for name, share in result.cpu_share.items()},
        "seconds": round(result.seconds, 2),
        "track": setup.track_name,
        "effects": dict(setup.config.plant.effects),
        "ending": result.ending.value,
        "signal": result.signal,
        "events": result.monitor.journal.entries(zero_ns),
        "revisions": result.monitor.journal.revisions(zero_ns),
        "ok": succeeded(options, result),
    }


def _driven(result: RunResult, limit_s: float | None) -> dict[str, Any]:
    """What the car did, by the referee."""
    referee = result.referee
    return {
        "laps": referee.laps,
        "lap_times_s": list(referee.lap_times_s),
        "limit_s": limit_s,
        "lap_ratio": lap_ratios(referee.lap_times_s, limit_s) if limit_s else [],
        "distance_m": round(referee.distance_m, 1),
        "peak_speed_mps": round(referee.peak_speed, 2),
        "off_track": referee.off_track,
        "spins": referee.spins,
        "friction_used": {axle: round(u, 3) for axle, u in zip(("front", "rear"), referee.friction_used, strict=True)},
        "friction_over_s": referee.friction_over_s,
    }


def _reported(result: RunResult) -> dict[str, Any]:
    """What gateway and planner say of themselves."""
    status, plans = result.monitor.status, result.monitor.plans
    return {
        "frames_received": status.frames_received if status else 0,
        "frames_lost": status.frames_lost if status else 0,
        "commands_sent": status.commands_sent if status else 0,
        "commands_limited": status.commands_limited if status else 0,
        "loop_latency_ms": {
            "p50": status.loop_latency_p50_ms if status else None,
            "p99": status.loop_latency_p99_ms if status else None,
        },
        "plan_ms": _percentiles(plans.solve_ms),
        "plans": len(plans.solve_ms),
        "plan_failures": plans.failures,
        "plan_failure_reasons": plans.reasons,
    }


def succeeded(options: DemoOptions, result: RunResult) -> bool:
    """Whether nothing was found that a test would call a failure."""
    status, recorder, referee = result.monitor.status, result.monitor.recorder, result.referee
    if result.ending is Ending.DONE and options.seconds is None and referee.laps < (options.target_laps or 0):
        return False
    clean = not (result.exits or result.monitor.failsafes or referee.off_track)
    recorded = recorder is None or recorder.errors == recorder.lost == 0
    nothing_lost = status is not None and status.frames_lost == 0 and recorded
    return result.ending in (Ending.DONE, Ending.INTERRUPTED) and clean and nothing_lost


def _percentiles(values: list[float]) -> dict[str, float | None]:
    if not values:
        return {"p50": None, "p99": None}
    return {"p50": round(float(np.percentile(values, 50)), 3), "p99": round(float(np.percentile(values, 99)), 3)}


def describe(summary: dict[str, Any]) -> list[str]:
    """The summary for a person."""
    distance, speed = figure(summary["distance_m"], "m"), figure(summary["peak_speed_mps"], "m/s", 3)
    laps = figure(summary["lap_times_s"], "s", 5)
    cpu = ", ".join(f"{name} {figure(round(100 * share), '%')}" for name, share in summary["cpu"].items())
    return [
        f"laps             {summary['laps']} ({laps})",
        f"distance         {distance}, peak speed {speed}",
        *_limit_lines(summary),
        f"off track        {summary['off_track']}",
        f"CAN              {summary['bus']}, {summary['frames_received']} frames in, {summary['frames_lost']} lost,"
        f" {summary['commands_sent']} commands sent, {summary['commands_limited']} limited",
        f"loop latency     {_quantiles(summary['loop_latency_ms'])}",
        f"planning         {_quantiles(summary['plan_ms'])}, {summary['plans']} plans,"
        f" {summary['plan_failures']} not fresh",
        f"processor        {cpu}",
        *_error_lines(summary["model_error"]),
        *(_failsafe_line(failsafe) for failsafe in summary["failsafes"]),
        *_recording_lines(summary["recorder"]),
        f"ended            {summary['ending']}",
        f"session          {summary['session']}",
    ]


def _limit_lines(summary: dict[str, Any]) -> list[str]:
    if not summary["lap_ratio"]:
        return []
    limit, ratios = figure(summary["limit_s"], "s", 4), figure(summary["lap_ratio"], "", 4)
    return [f"limit            {limit} by the plant's own equations; laps over it: {ratios}"]


def _error_lines(error: dict[str, Any]) -> list[str]:
    if error["before"] is None:
        return [f"model error      not measured: {error['reason']}"]
    channels = (
        f"{name} {figure(row['before'], digits=3)} -> {figure(row['after'], digits=3)}"
        for name, row in error["channels"].items()
    )
    return [f"model error      after 1 s of prediction, before -> after learning: {', '.join(channels)}"]


def _failsafe_line(failsafe: dict[str, Any]) -> str:
    detail = f": {failsafe['detail']}" if failsafe["detail"] else ""
    return f"failsafe         {failsafe['action']} at {figure(failsafe['t_s'], 's', 3)}: {failsafe['cause']}{detail}"


def _recording_lines(recorder: dict[str, Any]) -> list[str]:
    """What of the recording is missing, and why; nothing where it is whole."""
    if not recorder or recorder["errors"] == recorder["lost"] == 0:
        return []
    reason = f": {recorder['last_error']}" if recorder["last_error"] else ""
    return [f"recording        not whole, {recorder['lost']} frames and messages lost{reason}"]


def _quantiles(times_ms: dict[str, float | None]) -> str:
    return ", ".join(f"{name} {figure(value, 'ms', 3)}" for name, value in times_ms.items())
