"""Plain summary of one run of deploy/test.sh: steps, tests per kind of CAN, and the totals on a line of their own.

Reads the folder deploy/test.sh fills: `steps` and `failed` (one line each) and JUnit files `quiet.xml`, `normal.xml`,
`vcan.xml` and, for what was run again alone, the same with `-alone`. A test that fails and then passes alone has
failed, unless tests/second_try.toml names it with the reason that was measured.

    summary.py FOLDER           the summary
    summary.py FOLDER NAME      nothing but the exit code: whether the tests of NAME.xml count as passed
"""

from __future__ import annotations

import subprocess
import sys
import tomllib
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree

NO_CAN = "no CAN"
SECOND_TRY = Path(__file__).parents[1] / "tests" / "second_try.toml"
"""test -> measured reason why a busy machine may fail it"""


def outcomes(report: Path) -> dict[str, tuple[str, str]]:
    """Test -> (kind of CAN, passed | failed | skipped) of a run; a missing file has none."""
    first, again = _cases(report), _cases(report.with_stem(f"{report.stem}-alone"))
    excused = tomllib.loads(SECOND_TRY.read_text())
    return first | {name: found for name, found in again.items() if name in excused}


def _tell_second_tries(report: Path) -> None:
    counted = outcomes(report)
    for name, (_, alone) in sorted(_cases(report.with_stem(f"{report.stem}-alone")).items()):
        print(f"run again alone: {name}: {alone}, counts as {counted[name][1]}")


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
    for name in ("quiet", "normal", "vcan"):
        _tell_second_tries(folder / f"{name}.xml")
    results = [*outcomes(folder / "quiet.xml").values(), *outcomes(folder / "normal.xml").values()]
    results += [(f"{k} ({kind})", o) for k, o in outcomes(folder / "vcan.xml").values()]
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


def passed(report: Path) -> bool:
    """Whether every test of a run counts as passed."""
    counted = outcomes(report).values()
    return bool(counted) and all(outcome != "failed" for _, outcome in counted)


if __name__ == "__main__":
    place, *names = sys.argv[1:]
    raise SystemExit(main(Path(place)) if not names else not passed(Path(place, f"{names[0]}.xml")))
