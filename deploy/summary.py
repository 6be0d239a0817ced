"""Plain summary of one run of deploy/test.sh: steps, tests per kind of CAN, and the totals on a line of their own.

Reads the folder deploy/test.sh fills: `steps` and `failed` (one line each) and JUnit files `quiet.xml`, `normal.xml`,
`vcan.xml` and, for what was run again alone, the same with `-alone`.
"""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree

NO_CAN = "no CAN"


def outcomes(report: Path) -> list[tuple[str, str]]:
    """(kind of CAN, passed | failed | skipped) of every test of a run; a missing file has none.

    What failed and was run again alone counts by its second run, and is named.
    """
    first, again = _cases(report), _cases(report.with_stem(f"{report.stem}-alone"))
    for name in sorted(again):
        print(f"run again alone: {name}: {again[name][1]}")
    return list((first | again).values())


def _cases(report: Path) -> dict[str, tuple[str, str]]:
    """Test name -> (kind of CAN, outcome)."""
    if not report.exists():
        return {}
    cases = ElementTree.parse(report).iter("testcase")
    return {f"{case.get('classname')}.{case.get('name')}": (_kind(case), _outcome(case)) for case in cases}


def _kind(case: ElementTree.Element) -> str:
    kinds = [p.get("value", "") for p in case.iter("property") if p.get("name") == "can"]
    return kinds[0] if kinds else NO_CAN


def _outcome(case: ElementTree.Element) -> str:
    children = {child.tag for child in case}
    if children & {"failure", "error"}:
        return "failed"
    return "skipped" if "skipped" in children else "passed"


def _needing_vcan() -> list[str]:
    """Names of the tests that want a vcan interface, as pytest lists them."""
    # no -q here: pyproject.toml has one, and a second would list files instead of tests
    command = [sys.executable, "-m", "pytest", "-m", "vcan", "--collect-only", "tests/vcan"]
    listing = subprocess.run(command, capture_output=True, text=True, check=False)
    return [line for line in listing.stdout.splitlines() if "::" in line]


def _not_run(folder: Path) -> list[tuple[str, str]]:
    """Outcomes of the tests that want a vcan interface where there was none; prints their names and the reason."""
    tests = _needing_vcan()
    print("\n".join(f"not run: {name}" for name in tests))
    print(f"{len(tests)} tests not run, they need vcan: {(folder / 'vcan.log').read_text().strip()}")
    return [("vcan (not run)", "skipped")] * len(tests)


def main(folder: Path) -> int:
    """Print the summary; 1 when a step failed or no test ran. `failed` names vcan-tests where they were required."""
    kind = (folder / "vcan-kind").read_text().strip() if (folder / "vcan-kind").exists() else ""
    results = outcomes(folder / "quiet.xml") + outcomes(folder / "normal.xml")
    results += [(f"{k} ({kind})", o) for k, o in outcomes(folder / "vcan.xml")]
    if not (folder / "vcan.xml").exists():
        results += _not_run(folder)
    print((folder / "steps").read_text(), end="")
    for kind in sorted({kind for kind, _ in results}):
        counts = Counter(outcome for k, outcome in results if k == kind)
        print(f"tests on {kind}: " + ", ".join(f"{n} {outcome}" for outcome, n in sorted(counts.items())))
    total = Counter(outcome for _, outcome in results)
    print(f"{total['passed']} passed, {total['failed']} failed, {total['skipped']} skipped")
    failed = (folder / "failed").read_text().split() if (folder / "failed").exists() else []
    if failed:
        print("failed steps: " + ", ".join(failed), file=sys.stderr)
    return int(bool(failed) or total["failed"] > 0 or total["passed"] == 0)


if __name__ == "__main__":
    raise SystemExit(main(Path(sys.argv[1])))
