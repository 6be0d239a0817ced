"""can_dbc <- hil_gateway <- estimator <- planner: imports point one way, neither modules nor folders in a circle."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ORDER = ("can_dbc", "hil_gateway", "estimator", "planner")
MODULES_IN_A_FOLDER = 15
"""more than that is no longer read at a glance; the catalogue of effects, one file each, may have more"""


@cache
def _modules() -> dict[str, Path]:
    files = [file for package in ORDER for file in (ROOT / package).rglob("*.py")]
    return {".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): file for file in files}


def _imported(path: Path) -> set[str]:
    """Everything a file imports, at its top or inside functions; `from a import b` counts as a and as a.b."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


@cache
def _graph() -> dict[str, set[str]]:
    """Module -> modules it imports; a package's own `__init__` stands for no module here."""
    plain = {name for name, path in _modules().items() if path.name != "__init__.py"}
    return {name: (_imported(_modules()[name]) & plain) - {name} for name in plain}


def _reachable(start: str, graph: Mapping[str, set[str]]) -> set[str]:
    seen: set[str] = set()
    todo = list(graph[start])
    while todo:
        name = todo.pop()
        if name not in seen:
            seen.add(name)
            todo += graph[name]
    return seen


def _siblings() -> dict[str, dict[str, set[str]]]:
    """Folder -> its modules and subfolders -> those of the same folder that they import, subfolders as one."""
    found: dict[str, dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
    for name, path in _modules().items():
        for other in _imported(path) & _modules().keys() - {name}:
            parts, others = ((*name.split("."), ""), (*other.split("."), ""))
            depth = next(i for i, pair in enumerate(zip(parts, others, strict=False)) if pair[0] != pair[1])
            if parts[depth] and others[depth]:  # a package's own `__init__` is above what it holds
                found[".".join(parts[:depth])][parts[depth]].add(others[depth])
    return found


@pytest.mark.parametrize("package", ORDER)
def test_package_imports_only_packages_before_it(package: str) -> None:
    allowed = set(ORDER[: ORDER.index(package) + 1])
    files = list((ROOT / package).rglob("*.py"))
    assert files
    roots = {f: {name.split(".")[0] for name in _imported(f)} & set(ORDER) for f in files}
    assert {str(f.relative_to(ROOT)): extra - allowed for f, extra in roots.items() if extra - allowed} == {}


def test_no_modules_import_each_other_in_a_circle() -> None:
    assert sorted(name for name in _graph() if name in _reachable(name, _graph())) == []


def test_no_folders_import_each_other_in_a_circle() -> None:
    """At each level: a folder and a module beside it, or two folders, whatever lies in them."""
    siblings = _siblings()
    assert "estimator.offline" in siblings
    circles = {
        f"{folder}: {name}"
        for folder, graph in siblings.items()
        for name in [*graph]
        if name in _reachable(name, defaultdict(set, graph))
    }
    assert circles == set()


def test_no_folder_holds_more_modules_than_are_read_at_a_glance() -> None:
    folders: defaultdict[str, int] = defaultdict(int)
    for path in (*_modules().values(), *(ROOT / "tests").rglob("*.py"), *(ROOT / "benchmarks").rglob("*.py")):
        folders[str(path.parent.relative_to(ROOT))] += path.name != "__init__.py"
    crowded = {folder: count for folder, count in folders.items() if count > MODULES_IN_A_FOLDER}
    assert set(crowded) <= {"estimator/model/effects"}
