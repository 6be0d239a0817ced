"""Shared fixtures: optional measured data, which the repository does not carry; and which CAN a test ran on."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hypothesis
import pytest
from support.promise_figures import long_run, note_outcome, select

from hil_gateway.can_link.udp import UdpLink
from hil_gateway.can_link.virtual import VirtualLink
from hil_gateway.can_link.wire import WireLink

hypothesis.settings.register_profile(
    "any machine", hypothesis.settings(deadline=None, derandomize=not long_run())
)  # beside what is set already
hypothesis.settings.load_profile("any machine")
"""how long an example takes says nothing of the code on a machine that does other work; the long run looks for examples
that nobody has tried, the usual one judges a change"""

ROOT = Path(__file__).resolve().parents[1]


def _optional(variable: str, fallback: str) -> Path:
    path = Path(os.environ.get(variable, ROOT.parent / "shared" / fallback))
    if not path.is_dir():
        pytest.skip(f"optional data absent: set {variable} to its folder")
    return path


@pytest.fixture(scope="session")
def measured_data() -> Path:
    """Folder with measured and practice drive logs; the test is skipped where it is absent."""
    return _optional("HIL_DATA", "data")


@pytest.fixture(scope="session")
def measured_tracks() -> Path:
    """Folder with tracks in the TUM convention; the test is skipped where it is absent."""
    return _optional("HIL_TRACKS", "tracks")


_opened: set[str] = set()
"""kinds of CAN the running test has opened in this process"""


def pytest_configure(config: pytest.Config) -> None:
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a job in the background hands it on to what tests start
        signal.signal(signal.SIGINT, signal.default_int_handler)
    for link in (UdpLink, VirtualLink, WireLink):
        _note_opening(link)


def _note_opening(link: type[Any]) -> None:
    opening = link.__init__

    def noted(self: Any, *args: Any, **kwargs: Any) -> None:
        _opened.add(link.kind)
        opening(self, *args, **kwargs)

    link.__init__ = noted  # type: ignore[misc]


def pytest_runtest_setup(item: pytest.Item) -> None:
    _opened.clear()


def pytest_runtest_teardown(item: pytest.Item) -> None:
    """Kind of CAN of the test, for the summary of deploy/test.sh."""
    if item.get_closest_marker("vcan"):
        item.user_properties.append(("can", "vcan"))
    elif _opened:
        item.user_properties.append(("can", " and ".join(sorted(_opened))))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[Any]:
    """Outcomes of the promises' tests, for docs/promises.md."""
    report = yield
    note_outcome(item, report)
    return report


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """`hil verify --only`; long tests where they are asked for."""
    items[:] = select(items)
    if long_run() or "long" in config.option.markexpr:
        return
    left_out = [item for item in items if item.get_closest_marker("long")]
    config.hook.pytest_deselected(items=left_out)
    items[:] = [item for item in items if item not in left_out]
