"""The report of a bring-up check: JSON for programs, tables for people."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from can_dbc.database import id_text
from hil_gateway.gateway.check.arming import EXPLANATION
from hil_gateway.gateway.check.finding import Finding, Verdict
from hil_gateway.gateway.check.interface import Interface
from hil_gateway.gateway.check.traffic import MessageRow
from hil_gateway.process.model import Model

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

COLOUR = {Verdict.OK: "green", Verdict.INFO: "cyan", Verdict.WARN: "yellow", Verdict.FAIL: "bold red"}


class Report(Model):
    """Everything the check found."""

    channel: str
    bus: str
    seconds: float
    dbc_version: str
    frames: int
    interface: Interface | None
    findings: tuple[Finding, ...]
    messages: tuple[MessageRow, ...]
    unknown: dict[str, int]
    missing_for_arming: tuple[str, ...]
    failures: int
    warnings: int


def count(verdict: Verdict, findings: Sequence[Finding], messages: Sequence[MessageRow]) -> int:
    """How many findings and messages have this verdict."""
    verdicts = [finding.verdict for finding in findings] + [row.verdict for row in messages]
    return verdicts.count(verdict)


def print_report(report: Report, console: Console) -> None:
    """Findings, messages worth a line, and what arming still needs."""
    title = f"{report.channel} ({report.bus}), {report.seconds:.1f} s, {report.frames} frames, DBC {report.dbc_version}"
    console.print(title, style="bold", highlight=False)
    console.print(_findings_table(report.findings))
    if report.messages:
        console.print(_messages_table(report.messages))
    if report.missing_for_arming:
        console.print("before arming:", style="bold")
        for cause in report.missing_for_arming:
            console.print(f"  {cause:18} {EXPLANATION.get(cause, '')}", highlight=False)
    else:
        console.print("nothing stands in the way of arming", style="bold green")
    worst = "green" if report.failures == 0 else "bold red"
    console.print(f"failures: {report.failures}, warnings: {report.warnings}", style=worst, highlight=False)


def _findings_table(findings: Sequence[Finding]) -> RenderableType:
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, show_header=False)
    for finding in findings:
        detail = finding.detail + (f"\n-> {finding.remedy}" if finding.remedy else "")
        verdict = Text(finding.verdict.value, style=COLOUR[finding.verdict])
        table.add_row(verdict, Text(finding.area), Text(finding.name), Text(detail))
    return table


def _messages_table(rows: Sequence[MessageRow]) -> RenderableType:
    """Rows that say something; the rest are summed up in the last line."""
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in ("", "id", "message", "Hz", "due", "longest gap", "counter", ""):
        table.add_column(heading, justify="right" if heading in ("Hz", "due", "longest gap") else "left")
    shown = [row for row in rows if row.frames or row.wrong_lengths or row.verdict in (Verdict.WARN, Verdict.FAIL)]
    for row in shown:
        gap = "-" if row.longest_gap_ms is None else f"{row.longest_gap_ms:.0f} ms"
        verdict = Text(row.verdict.value, style=COLOUR[row.verdict])
        cells = (id_text(row.id), row.name, f"{row.hz:.1f}", f"{row.expected_hz:g}", gap, row.counter, row.detail)
        table.add_row(verdict, *map(Text, cells))
    silent = [row for row in rows if row not in shown and row.direction == "car"]
    if silent:
        names = ", ".join(row.name for row in silent[:4]) + (", ..." if len(silent) > 4 else "")
        table.add_row("", "", Text(f"{len(silent)} further messages of the car are not there: {names}"))
    return table
