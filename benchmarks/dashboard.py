"""The live page over a long time: processor of the server, and memory of server and browser.

    PYTHONPATH=tests python -m benchmarks.dashboard SESSION [--seconds 1800] [--json]

A recorded session of two laps or more is played back on Zenoh in real time, again and again; `hil dashboard` shows it
and Chromium keeps the page open. Asked: at most 5 % of a core, and memory that does not grow.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from support.browser import Browser

CORE_PERCENT = 5.0
"""asked of the server"""
GROWTH = 1.05
"""asked: memory of the last quarter over that of the second, in which all charts are full"""
SAMPLE_S = 5.0
HEAP = "performance.memory.usedJSHeapSize"


def _hil(*words: str) -> list[str]:
    return [str(Path(sys.executable).with_name("hil")), *words]


def _played(config: Path, session: Path) -> subprocess.Popen[bytes]:
    command = _hil("session", "replay", str(session), "--config", str(config))
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _memory_mb(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port: int = listener.getsockname()[1]
        return port


def measured(session: Path, seconds: float, folder: Path) -> dict[str, Any]:
    """Figures of `seconds` with the page open."""
    config, port = folder / "config.toml", _free_port()
    config.write_text(f'[zenoh]\nconnect = ["tcp/127.0.0.1:{_free_port()}"]\n')
    server = subprocess.Popen(_hil("dashboard", "run", "--config", str(config), "--port", str(port)))
    player = _played(config, session)
    rows = []
    try:
        with Browser(folder / "profile", "1600,1000") as page:
            time.sleep(3.0)
            page.open(f"http://127.0.0.1:{port}/")
            page.wait_for("document.querySelectorAll('.uplot').length > 3", 120.0)
            started_s, cpu_s = time.monotonic(), _cpu_s(server.pid)
            while (passed_s := time.monotonic() - started_s) < seconds:
                rows.append((passed_s, _memory_mb(server.pid), page.evaluate(HEAP) / 1e6))
                if player.poll() is not None:
                    player = _played(config, session)
                time.sleep(SAMPLE_S)
            core_percent = 100.0 * (_cpu_s(server.pid) - cpu_s) / passed_s
            state = page.evaluate("document.querySelector('.pill').textContent")
    finally:
        for process in (player, server):
            process.terminate()
            process.wait(timeout=20)
    return {
        "seconds": round(passed_s),
        "core_percent": round(core_percent, 2),
        "shown": state,
        **_growth(np.array(rows)),
    }


def _growth(rows: np.ndarray[Any, Any]) -> dict[str, float]:
    """Memory of server and page, MB, in the second and the last quarter: the least, which is left after collections."""
    quarters = np.array_split(rows[:, 1:], 4)
    second, last = quarters[1].min(axis=0), quarters[3].min(axis=0)
    names = ("server_mb", "page_mb")
    figures = {f"{name}_second_quarter": round(float(value), 1) for name, value in zip(names, second, strict=True)}
    return figures | {f"{name}_last_quarter": round(float(value), 1) for name, value in zip(names, last, strict=True)}


def main() -> None:
    """Print the figures; exit 1 where one misses what is asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("session", type=Path)
    parser.add_argument("--seconds", type=float, default=1800.0)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        figures = measured(arguments.session, arguments.seconds, Path(folder))
    print(json.dumps(figures) if arguments.json else "\n".join(f"{k:28} {v}" for k, v in figures.items()))
    grew = any(figures[f"{n}_last_quarter"] > GROWTH * figures[f"{n}_second_quarter"] for n in ("server_mb", "page_mb"))
    raise SystemExit(figures["core_percent"] > CORE_PERCENT or grew)


if __name__ == "__main__":
    main()
