"""Errors after local refinement, and how often it makes things worse."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmark.pairs import Pair
from benchmark.refinement_runs import PERTURBED, RIGHT, START, Errors, Outcome
from benchmark.scoring import OVERLAPS
from benchmark.store import Record
from benchmark.table import Json, Table
from fewview.evaluation.metrics import within
from fewview.types import Array

GROUPS = (">= 10 %", "< 10 %")
NOTICED_M = 0.005
"""A pose has become worse when its surface error grew by more."""
HEAD = ("refinement", "perturbed", "mean", "right", "right start", "mean", "worse", "CPU s")
NOTE = (
    "Perturbed: median rotation error in degrees / median translation error in metres after "
    "refinement from true poses that were turned by up to 30 degrees and moved by up to 0.5 m an "
    "axis, then their means, and the share that is right (15 degrees, 0.3 m). Right start: the "
    "same errors from starts within these 15 degrees and 0.3 m, and the share that refinement "
    f"leaves worse: their surface is off by {NOTICED_M * 1000:.0f} mm more on average than before. "
    "CPU s: of a pair with five candidates, scans prepared."
)


def rows(pairs: Sequence[Pair], records: Sequence[Record[Outcome]]) -> list[Json]:
    """One row a pair."""
    return [
        {"overlap": pair.overlap, "errors": record.answer, "seconds": record.seconds}
        for pair, record in zip(pairs, records, strict=True)
        if record.answer is not None
    ]


def summarise(rows: Sequence[Json], names: Sequence[str]) -> Json:
    """By overlap class and refinement; classes without pairs are left out."""
    members = {group: [row for row in rows if OVERLAPS[group](row)] for group in GROUPS}
    return {
        group: {"pairs": len(found)} | {name: _scores(found, name) for name in (START, *names)}
        for group, found in members.items()
        if found
    }


def table(title: str, labels: Mapping[str, str], summary: Json) -> Table:
    """All refinements, a block of rows an overlap class."""
    lines: list[Sequence[str]] = []
    for group, found in summary.items():
        lines.append([f"overlap {group} ({found['pairs']} pairs)"])
        lines += [_line(label, found[name]) for name, label in labels.items()]
    return Table(title, NOTE, HEAD, lines)


def _scores(rows: Sequence[Json], name: str) -> Json:
    scores: dict[str, Any] = {}
    for kind in (PERTURBED, RIGHT):
        before, after = (_stacked(rows, kind, n) for n in (START, name))
        scores[kind] = {
            "median": _pose(np.median, after),
            "mean": _pose(np.mean, after),
            "surface_m": float(np.median(after.surface_m)),
            "right": float(within(after.rotation_deg, after.translation_m).mean()),
            "worse": float((after.surface_m > before.surface_m + NOTICED_M).mean()),
        }
    taken = [row["seconds"][name] for row in rows if name in row["seconds"]]
    return scores | {"seconds": float(np.median(taken)) if taken else None}


def _stacked(rows: Sequence[Json], kind: str, name: str) -> Errors:
    found: list[Errors] = [row["errors"][kind][name] for row in rows]
    columns = ("rotation_deg", "translation_m", "surface_m")
    return Errors(*(np.concatenate([getattr(e, column) for e in found]) for column in columns))


def _pose(mean: Any, errors: Errors) -> Json:
    values: tuple[Array, Array] = (errors.rotation_deg, errors.translation_m)
    return dict(zip(("rotation_deg", "translation_m"), map(float, map(mean, values)), strict=True))


def _line(label: str, found: Json) -> list[str]:
    far, near, seconds = found[PERTURBED], found[RIGHT], found["seconds"]
    return [
        label,
        _cell(far["median"]),
        _cell(far["mean"]),
        f"{far['right']:.2f}",
        _cell(near["median"]),
        _cell(near["mean"]),
        f"{near['worse']:.3f}",
        "-" if seconds is None else f"{seconds:.2f}",
    ]


def _cell(pose: Json) -> str:
    return f"{pose['rotation_deg']:.2f} / {pose['translation_m']:.3f}"
