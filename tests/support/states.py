"""Pictures of the live page in every state, out of a real run: `PYTHONPATH=tests python -m support.states FOLDER`.

A demo drives; its planner is killed in the first lap; then the demo is ended. For people to look at.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from support.browser import Browser

DRIVING_S, STOPPING_S, STANDING_S, LOST_S = 35.0, 1.0, 4.0, 4.0
"""how long each state lasts before its picture"""
SIZES = {"laptop": (1600, 1000), "screen": (2560, 1440), "phone": (390, 844), "projector": (1280, 720)}
ADDRESS = re.compile(r"http://127\.0\.0\.1:\d+/")


def _demo(out: Path) -> subprocess.Popen[str]:
    hil = str(Path(sys.executable).with_name("hil"))
    command = [hil, "demo", "--seconds", "300", "--headless", "--dashboard", "--no-learn", "--out", str(out)]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def _address(demo: subprocess.Popen[str]) -> str:
    assert demo.stderr is not None
    for line in demo.stderr:
        if found := ADDRESS.search(line):
            threading.Thread(target=demo.stderr.read, daemon=True).start()  # or its pipe fills up
            return found[0]
    raise AssertionError("the demo names no page")


def _child(parent: int, words: str) -> int:
    """Process of the demo that has `words` in its command line."""
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and words in (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode():
            fields = (entry / "stat").read_text().rsplit(")", 1)[1].split()
            if int(fields[1]) == parent:
                return int(entry.name)
    raise AssertionError(f"no process {words}")


def take(folder: Path) -> None:
    """Write one picture a state, driving in every size and both themes."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        demo = _demo(Path(scratch) / "out")
        try:
            url = _address(demo)
            with Browser(Path(scratch) / "profile", "1600,1000") as page:
                _follow(page, url, demo, folder)
        finally:
            demo.send_signal(signal.SIGINT)
            demo.wait(timeout=60)


def _follow(page: Browser, url: str, demo: subprocess.Popen[str], folder: Path) -> None:
    page.resize(*SIZES["laptop"])
    page.open(f"{url}?theme=dark")
    page.wait_for("document.querySelector('.pill') !== null")
    time.sleep(2.0)
    page.screenshot(folder / "start.png")
    time.sleep(DRIVING_S)
    for theme in ("dark", "light"):
        page.open(f"{url}?theme={theme}")
        for name, size in SIZES.items():
            page.resize(*size)
            time.sleep(1.5)
            page.screenshot(folder / f"driving-{name}-{theme}.png")
    page.resize(*SIZES["laptop"])
    os.kill(_child(demo.pid, "planner run"), signal.SIGKILL)
    for name, seconds in (("stopping", STOPPING_S), ("standing", STANDING_S)):
        time.sleep(seconds)
        page.screenshot(folder / f"{name}.png")
    demo.send_signal(signal.SIGINT)
    demo.wait(timeout=60)
    time.sleep(LOST_S)
    page.screenshot(folder / "lost.png")


if __name__ == "__main__":
    take(Path(sys.argv[1]))
