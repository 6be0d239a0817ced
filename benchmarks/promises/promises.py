"""The reliability promises: what each says, the figure it is held to, and the report of what was reached."""

from __future__ import annotations

import json
import textwrap
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Promise:
    """One promise and its figure."""

    id: str
    text: str
    figure: str


PROMISES: tuple[Promise, ...] = (
    Promise(
        "S1",
        "Nothing outside limits is ever sent, judged on the bytes by an independent decoder",
        "10^6 hostile commands",
    ),
    Promise(
        "S2",
        "A legal command passes unchanged",
        "within 1 LSB, random legal commands",
    ),
    Promise(
        "S3",
        "Only declared identifiers and lengths leave",
        "all 2,048 identifiers x DLC 0..8",
    ),
    Promise(
        "S4",
        "Command counters advance by 1 mod 256; period 10 ms",
        "p99.9 within 2 ms on an idle machine",
    ),
    Promise(
        "S5",
        "Silent by default; arming is an edge that needs every condition; a failsafe latches",
        "each condition missing once",
    ),
    Promise(
        "S6",
        "Limits, failsafe and codec: every branch covered, no surviving mutant without a reason",
        "100 % branches, mutation run",
    ),
    Promise(
        "S7",
        "An oracle written from the failsafe table agrees with the code",
        "10^5 sequences",
    ),
    Promise(
        "L1",
        "Plan older than 100 ms: controlled stop; older than 500 ms: emergency stop",
        "first safe frame within one period",
    ),
    Promise(
        "L2",
        "State or estimate invalid for 50 ms: controlled stop",
        "one period",
    ),
    Promise(
        "L3",
        "CAN silent for 100 ms, or 5 wrong counters (leaky): fault and stop",
        "one period",
    ),
    Promise(
        "L4",
        "Heartbeat frozen for 500 ms: coordinated stop; purple flag, e-kill, ct_state 12: emergency",
        "next period",
    ),
    Promise(
        "L5",
        "A hanging gateway's counters stop; restarted by the watchdog, it is silent",
        "200 ms watchdog",
    ),
    Promise(
        "L6",
        "Killing, stopping or starving a process ends in the specified state; recorder and dashboard change nothing",
        "200 times",
    ),
    Promise(
        "L7",
        "Bus-off, interface down or replugged: state invalid meanwhile, recovered without a restart",
        "1 s",
    ),
    Promise(
        "F1",
        "Any identifier, any length, any bytes: no exception, no non-finite state",
        "10^6 frames",
    ),
    Promise(
        "F2",
        "Encode and decode are inverse and agree with cantools on every message",
        "all 53 messages, every raw range",
    ),
    Promise(
        "R1",
        "kill -9 loses at most 200 ms of recording, the rest is recovered",
        "100 kills",
    ),
    Promise(
        "R2",
        "Disk full, I/O error, slow disk: command timing unaffected, loss counted and reported",
        "fail at the Nth write",
    ),
    Promise(
        "R3",
        "A recording cut anywhere in its last 64 KiB recovers; a corrupt chunk is named",
        "every byte",
    ),
    Promise(
        "R4",
        "Replaying a session gives byte-identical estimator outputs",
        "twice, and against the recording",
    ),
    Promise(
        "N1",
        "Belief covariance stays symmetric positive semi-definite, parameters within bounds",
        "10^6 random updates",
    ),
    Promise(
        "N2",
        "Jacobians agree with finite differences; mirror exact; RK4 of order 4",
        "1,000 random points, 1e-6",
    ),
    Promise(
        "N3",
        "Filter consistency: NEES and NIS within their 95 % bands",
        "200 runs with known truth",
    ),
    Promise(
        "N4",
        "Every accepted plan meets its constraints; failure gives the shifted plan, then a stop plan",
        "all plans of a run",
    ),
    Promise(
        "D1",
        "Every single sensor or actuator fault is noticed in its stated time, or does no harm",
        "10,000 seeds, all tracks and speeds",
    ),
    Promise(
        "D2",
        "Every stop after such a fault keeps to the road where physics allows it",
        "99 % of those seeds, each exception explained",
    ),
    Promise(
        "D3",
        "No accepted configuration disables steering or brakes",
        "10^4 random configurations",
    ),
    Promise(
        "D4",
        "Every input has a bound in size, time and memory",
        "flood and bomb set",
    ),
    Promise(
        "G1",
        "Nothing starts by itself: no cranking, released brake or motion without a person's request",
        "every state of the ladder x restart of every process",
    ),
    Promise(
        "G2",
        "A car that stands is held, and knows where it points or says that it does not",
        "10 min, 9 % grade, 20 deg bank, pushed 30 m: 0.1 m rolled, heading within 0.02 rad or not valid",
    ),
    Promise(
        "G3",
        "Armed means under way within 2 s, or the reason is said",
        "1,000 places and headings, all tracks and their pit lanes",
    ),
)


@dataclass
class Evidence:
    """What the tests of one promise said."""

    tests: dict[str, str] = field(default_factory=dict)
    """test -> passed | failed | skipped"""
    figures: list[str] = field(default_factory=list)
    again: set[str] = field(default_factory=set)
    """tests that failed and passed when they were run again"""
    missed: bool = False
    """a figure is less than what the promise requires"""

    @property
    def verdict(self) -> str:
        """Kept when a test passed, none failed and every figure is what is required."""
        outcomes = set(self.tests.values())
        if "failed" in outcomes:
            return "BROKEN"
        if self.missed:
            return "missed"
        if "passed" not in outcomes:
            return "not proved here"
        return "kept on the second try" if self.again else "kept"


def read_evidence(path: Path) -> dict[str, Evidence]:
    """Gather the lines the tests wrote (`tests/support/promise_figures.py`)."""
    evidence = {promise.id: Evidence() for promise in PROMISES}
    for line in path.read_text().splitlines() if path.exists() else ():
        entry = json.loads(line)
        of = evidence.setdefault(entry["promise"], Evidence())
        if "test" in entry:
            if of.tests.get(entry["test"]) == "failed" and entry["outcome"] == "passed":
                of.again.add(entry["test"])
            of.tests[entry["test"]] = entry["outcome"]  # a test run again counts by its last run
        elif entry["figure"] not in of.figures:
            of.figures.append(entry["figure"])
            of.missed |= entry.get("missed", False)
    return evidence


def keep_long(path: Path, evidence: dict[str, Evidence], conditions: str) -> None:
    """Put what a long run said in the place of what earlier long runs said of the same promises."""
    kept = json.loads(path.read_text()) if path.exists() else {}
    for name, of in evidence.items():
        if of.tests:
            kept[name] = {"verdict": of.verdict, "figures": of.figures, "run": conditions}
    path.write_text(json.dumps(kept, indent=1, sort_keys=True) + "\n")


HEAD = """# Promises

For whoever relies on the gateway. Written by `hil verify --page FILE`.

A promise without a test fails the test suite. The usual run, part of every `deploy/test.sh`, does less than is required
where that takes long, and its verdict is about that part. `hil verify --long` does all.
"""

LINE = 200
"""characters of figures that are read; `hil verify --json` has all"""


def markdown(evidence: dict[str, Evidence], conditions: str, long: dict[str, dict[str, Any]]) -> str:
    """`docs/promises.md`; `long` is what `keep_long` keeps."""
    runs = sorted({str(whole["run"]) for whole in long.values()})
    lines = [
        HEAD,
        f"- Usual run: {conditions}",
        "- Long runs (`promises-long.json` has their length, version and machine): "
        + ", ".join(f"{number} of {run[:16]}" for number, run in enumerate(runs, 1)),
        "",
        "| id | promise | required | usual run | long run |",
        "| --- | --- | --- | --- | --- |",
    ]
    for promise in PROMISES:
        whole = long.get(promise.id)
        cells = [promise.id, promise.text, promise.figure, evidence[promise.id].verdict]
        cells += [f"{whole['verdict']} ({runs.index(whole['run']) + 1})" if whole else "not run"]
        lines.append(f"| {' | '.join(cells)} |")
    lines += ["", "Figures of the long run where there is one, else of the usual run:", ""]
    lines += [_reached(promise.id, evidence[promise.id], long.get(promise.id)) for promise in PROMISES]
    return "\n".join(lines) + "\n"


def _reached(name: str, usual: Evidence, whole: dict[str, Any] | None) -> str:
    """One line: what was reached for a promise; all of it where one is not kept."""
    figures = [" ".join(figure.split()) for figure in (whole or {}).get("figures", ()) or usual.figures]
    line = f"- **{name}** {'; '.join(_folded(figures)) or 'no figure'}"
    kept = {usual.verdict, (whole or {}).get("verdict", "kept")} == {"kept"}
    return textwrap.shorten(line, LINE, placeholder=" ...") if kept else line


def _folded(figures: list[str]) -> list[str]:
    """Figures that differ from the one before in one word only share a line."""
    folded: list[list[list[str]]] = []
    for words in (figure.split() for figure in figures):
        before = folded[-1] if folded else []
        if (
            len(before) == len(words)
            and sum(w not in seen for w, seen in zip(words, before, strict=True)) == 1
            and len(words) > 3
        ):
            folded[-1] = [seen if w in seen else [*seen, w] for w, seen in zip(words, before, strict=True)]
        else:
            folded.append([[word] for word in words])
    return [" ".join(", ".join(seen) for seen in line) for line in folded]


def as_json(evidence: dict[str, Evidence]) -> list[dict[str, object]]:
    """For `hil verify --json`."""
    return [
        {
            "id": promise.id,
            "promise": promise.text,
            "required": promise.figure,
            "reached": evidence[promise.id].figures,
            "verdict": evidence[promise.id].verdict,
            "tests": evidence[promise.id].tests,
        }
        for promise in PROMISES
    ]
