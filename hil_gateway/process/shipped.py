"""Files that come with the packages: tracks, configuration of the car, access-control list, page and report templates.

Found by package, so that a checkout, an installed wheel and the vehicle's /opt read the same ones.
"""

from __future__ import annotations

import difflib
from importlib.resources import files
from pathlib import Path

from can_dbc.folder import FILES
from hil_gateway.process.errors import InputError

NEEDED: dict[str, tuple[str, ...]] = {
    "can_dbc": tuple(f"{car}/{name}" for car in ("av21", "av24", "kestrel") for name in (f"{car}.dbc", *FILES)),
    "hil_gateway": (
        "data/av24.toml",
        "data/secure.json5",
        "data/plotjuggler-layout.xml",
        "data/tracks/oval.toml",
        "data/tracks/road_course.toml",
        "dashboard/page/index.html",
        "dashboard/page/app.js",
        "dashboard/page/look.css",
        "dashboard/page/style.css",
        "dashboard/page/uplot/uPlot.iife.min.js",
    ),
    "estimator": ("offline/report/templates/report.html",),
}
"""package -> files without which a command would fail; `hil doctor` looks for them"""
TEMPLATES = ("av24.toml", "secure.json5", "plotjuggler-layout.xml")
"""to be copied and edited: configuration of the car, Zenoh with certificates, a layout of PlotJuggler for recordings;
`hil doctor --template` prints them"""


def shipped(package: str, name: str = "") -> Path:
    """Path of a file or folder of a package, whether it exists or not."""
    return Path(str(files(package))) / name


def missing_files() -> list[str]:
    """What of `NEEDED` is not there, as package/file."""
    return [f"{package}/{name}" for package, names in NEEDED.items() for name in names if not _there(package, name)]


def _there(package: str, name: str) -> bool:
    try:
        return shipped(package, name).is_file()
    except ModuleNotFoundError:
        return False


def template(name: str) -> str:
    """Text of one of `TEMPLATES`.

    Raises:
        InputError: no such template.
    """
    if name not in TEMPLATES:
        raise InputError(f"{name}: no such template; there are {', '.join(TEMPLATES)}")
    return shipped("hil_gateway", f"data/{name}").read_text()


def did_you_mean(name: str, known: list[str]) -> str:
    """Words to follow an unknown name: the nearest known one, or nothing."""
    near = difflib.get_close_matches(name, known, n=1)
    return f"did you mean {near[0]}? " if near else ""
