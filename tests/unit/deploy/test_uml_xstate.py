"""The library preloaded into user-mode Linux: register areas shorter than the machine's are accepted.

Runs a tracer of its own (`tests/support/short_xstate.c`). An area of 576 bytes lacks the high halves of the AVX
registers, so that it is too short on any processor with AVX, as the area of user-mode Linux is on one with AMX.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
DEPLOY = ROOT / "deploy"
WITHOUT_AVX = 576
"""bytes: x87, SSE and the header; the shortest area in the standard format"""

pytestmark = [
    pytest.mark.skipif(shutil.which("gcc") is None, reason="needs a C compiler: apt-get install gcc libc6-dev"),
    pytest.mark.skipif(" avx " not in Path("/proc/cpuinfo").read_text(), reason="this processor has no AVX state"),
]

Tracer = Callable[..., str]


def build_library(cache: Path) -> Path:
    """The library as with-vcan builds it."""
    settings = {"here": str(DEPLOY), "cache": str(cache)}
    command = ["bash", "-c", '. "$here/vcan-uml.sh"; xstate_library']
    result = subprocess.run(
        command, capture_output=True, text=True, check=True, timeout=60, env={**os.environ, **settings}
    )
    assert result.stderr == ""
    return Path(result.stdout.strip())


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_library(tmp_path_factory.mktemp("cache of mine"))


@pytest.fixture(scope="module")
def tracer(library: Path, tmp_path_factory: pytest.TempPathFactory) -> Tracer:
    folder = tmp_path_factory.mktemp("tracer")
    program = folder / "short_xstate"
    source = Path(__file__).parents[2] / "support" / "short_xstate.c"
    subprocess.run(["gcc", "-O1", "-mavx", "-Wall", "-Werror", "-o", program, source], check=True, timeout=60)
    preload = folder / "xstate.so"
    preload.symlink_to(library)

    def run(argument: int | str, preloaded: bool = True) -> str:
        extra = {"LD_PRELOAD": str(preload)} if preloaded else {}
        command = [program, str(argument)]
        result = subprocess.run(
            command, capture_output=True, text=True, check=True, timeout=60, env={**os.environ, **extra}
        )
        assert result.stderr == ""
        return result.stdout.strip()

    return run


def test_short_area_is_refused_by_the_host_and_accepted_through_the_library(tracer: Tracer) -> None:
    assert tracer(WITHOUT_AVX, preloaded=False) == "refused 14"
    assert tracer(WITHOUT_AVX).startswith("low set ")


def test_state_that_the_short_area_lacks_is_initial_and_not_left_over(tracer: Tracer) -> None:
    """The high half of ymm0 held a value in use, marked so in XSTATE_BV of the short area."""
    assert tracer(WITHOUT_AVX) == f"low set high zero iov_len {WITHOUT_AVX}"


def test_state_that_the_short_area_holds_is_kept(tracer: Tracer) -> None:
    """Everything but the last eight bytes of the machine's area."""
    length = int(tracer(0, preloaded=False)) - 8
    if length < WITHOUT_AVX + 256:
        pytest.skip("AVX is the last state of this processor: nothing shorter holds it")
    assert tracer(length) == f"low set high loaded iov_len {length}"


def test_area_long_enough_passes_through_as_it_is(tracer: Tracer) -> None:
    length = int(tracer(0))
    assert tracer(length) == tracer(length, preloaded=False) == f"low set high loaded iov_len {length}"


def test_words_of_a_process_are_read_as_with_libc(tracer: Tracer) -> None:
    """-1 is a word like any other, and an address that is not there is an error."""
    assert tracer("peek") == tracer("peek", preloaded=False) == "word -1 errno 0, nowhere -1 refused 1"


def test_library_is_built_once_and_kept_by_its_content(library: Path) -> None:
    before = library.stat().st_mtime_ns
    assert build_library(library.parent) == library
    assert library.stat().st_mtime_ns == before
    assert list(library.parent.iterdir()) == [library]
