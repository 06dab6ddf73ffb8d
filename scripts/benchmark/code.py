"""Fingerprints of code: an answer is made again when anything that its method runs has changed."""

from __future__ import annotations

import ast
import hashlib
from functools import cache
from pathlib import Path

SCRIPTS = Path(__file__).resolve().parents[1]
ROOTS = {"benchmark": SCRIPTS, "fewview": SCRIPTS.parent}
"""Our own packages and where they are; what is imported from elsewhere does not count."""
DATA = (".json", ".yaml", ".safetensors")
"""Files beside the code that it reads: they count with the package that holds them."""
SCORING = "fewview.evaluation"
"""Scores answers and makes none."""


@cache
def fingerprint(module: str) -> str:
    """Twelve hex digits of all our source that a module reaches through imports."""
    digest = hashlib.sha256()
    paths = reached(module)
    for path in sorted(paths | _data_beside(paths)):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:12]


def reached(module: str) -> set[Path]:
    """Source files of a module and of all our modules that it imports, at any depth."""
    found: dict[str, Path] = {}
    waiting = [module]
    while waiting:
        name = waiting.pop()
        path = _source(name)
        if path is None or name in found or name.startswith(SCORING):
            continue
        found[name] = path
        waiting += _imported(path)
    return set(found.values())


def _imported(path: Path) -> list[str]:
    names: list[str] = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return names


def _source(module: str) -> Path | None:
    top = module.partition(".")[0]
    if top not in ROOTS:
        return None
    path = ROOTS[top].joinpath(*module.split("."))
    candidates = (path.with_suffix(".py"), path / "__init__.py")
    return next((p for p in candidates if p.is_file()), None)


def _data_beside(paths: set[Path]) -> set[Path]:
    folders = {p.parent for p in paths if ROOTS["fewview"] / "fewview" in p.parents}
    return {p for folder in folders for p in folder.rglob("*") if p.suffix in DATA}
