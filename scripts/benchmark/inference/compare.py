"""Every method on every problem: energy, scans right, seconds."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmark.inference.methods import Method
from benchmark.inference.problems import Posed
from benchmark.table import Table
from fewview.evaluation.gauge import absolute_errors
from fewview.global_stage.placement import State, objective
from fewview.types import Array

Json = dict[str, Any]
AT_BEST = 0.5
"""Gaps below this are of the same places, a little shifted."""
NOTE = (
    f"Gap of the objective to the best of all methods, mean (share of problems with a gap below "
    f"{AT_BEST}); share of scans right together (15 degrees, 0.3 m) in the largest component; CPU "
    "seconds a problem."
)


def rows_of(methods: Mapping[str, Method], problems: Iterable[Posed], seed: int) -> list[Json]:
    """A row for every problem and method."""
    rows = []
    for number, posed in enumerate(problems):
        own = [_row(name, method, posed, seed) for name, method in methods.items()]
        best = max(row["objective"] for row in own)
        rows += [
            {"problem": number, "group": posed.group, **row, "gap": best - row["objective"]}
            for row in own
        ]
    return rows


def _row(name: str, method: Method, posed: Posed, seed: int) -> Json:
    start = time.process_time()
    state = method.solve(posed.problem, seed)
    seconds = time.process_time() - start
    return {
        "method": name,
        "scans": posed.problem.scans,
        "candidates": len(posed.problem.source),
        "objective": objective(posed.problem, state),
        "right": int(absolute_errors(posed.truth, _largest(state)).agreeing.sum()),
        "seconds": seconds,
    }


def _largest(state: State) -> list[Array | None]:
    """Poses of the largest component, of equals that with the first scan."""
    size = (state.component[:, None] == state.component).sum(axis=1)
    label = state.component[int(np.argmax(size))]
    return [
        pose if own == label else None
        for pose, own in zip(state.pose, state.component, strict=True)
    ]


def summary_of(rows: Sequence[Json]) -> list[Json]:
    """Means by group and method."""
    summary = []
    for group, method in dict.fromkeys((row["group"], row["method"]) for row in rows):
        own = [r for r in rows if (r["group"], r["method"]) == (group, method)]
        gaps = np.array([row["gap"] for row in own])
        summary.append(
            {
                "group": group,
                "method": method,
                "problems": len(own),
                "gap": float(gaps.mean()),
                "at_best": float(np.mean(gaps < AT_BEST)),
                "right": sum(r["right"] for r in own) / sum(r["scans"] for r in own),
                "seconds": float(np.mean([row["seconds"] for row in own])),
            }
        )
    return summary


def table_of(summary: Sequence[Json], methods: Mapping[str, Method], title: str) -> Table:
    """A group of rows for every group of problems."""
    rows: list[list[str]] = []
    for group in dict.fromkeys(one["group"] for one in summary):
        own = [one for one in summary if one["group"] == group]
        rows.append([f"{group} ({own[0]['problems']} problems)"])
        rows += [
            [
                methods[one["method"]].label,
                f"{one['gap']:.2f} ({one['at_best']:.2f})",
                f"{one['right']:.2f}",
                f"{one['seconds']:.2f}",
            ]
            for one in own
        ]
    return Table(title, NOTE, ("method", "gap (at the best)", "right", "seconds"), rows)
