"""Tables whose rows are relative-pose methods and whose columns are errors over pairs."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import Any

from benchmark.catalogue import Method
from benchmark.command import answered_pairs, opened, out_path, pair_list, settings
from benchmark.pairs import difficulty
from benchmark.scoring import OVERLAPS, best_ranks, summarise, yaw_classes
from benchmark.table import Table, pose_cell, write

Json = dict[str, Any]
TOP = ("1", "3", "5")
NOTE = (
    "Cells: mean rotation error in degrees / mean translation error in metres. Top-k takes, of "
    "the first k candidates, the one nearest in rotation (the paper's definition); a method that "
    "gives one candidate has it in all three. Median: of top-1. Centroid: top-1 translation at "
    "the source's centroid. Recall: share of pairs with a right candidate (15 degrees, 0.3 m) "
    "first, or among five. Failed: pairs without an answer; they count with the identity."
)
HEAD = (
    "method",
    "top-1",
    "top-3",
    "top-5",
    "median",
    "centroid m",
    "recall@1",
    "recall@5",
    "failed",
    "CPU s",
)
YAW_NOTE = (
    "Mean top-1 rotation error in degrees (recall@1) by the true angle between the viewing "
    "directions seen from above."
)


def make(
    options: argparse.Namespace, methods: Mapping[str, Method], title: str
) -> tuple[Json, str]:
    """Run the methods, write JSON, Markdown and LaTeX; returns the results and the Markdown."""
    dataset = opened(options)
    pairs = pair_list(options, dataset)
    rows = answered_pairs(options, dataset, pairs, list(methods.values()))
    summary = {
        name: {
            "key": method.key,
            "overlap": summarise(rows[method.key], OVERLAPS),
            "yaw": summarise(rows[method.key], yaw_classes()),
            "best_rank": best_ranks(rows[method.key]),
        }
        for name, method in methods.items()
    }
    results = {
        **settings(options, dataset),
        "difficulty": difficulty(pairs.pairs),
        "methods": summary,
    }
    where = f"{title}, {dataset.name}, {len(pairs.pairs)} pairs, seed {options.seed}"
    tables = [overlap_table(where, methods, summary), yaw_table(where, methods, summary)]
    return results, write(out_path(options, dataset), results, tables)


def overlap_table(title: str, methods: Mapping[str, Method], summary: Mapping[str, Json]) -> Table:
    """All columns, a block of rows an overlap class."""
    rows: list[Sequence[str]] = []
    for group in OVERLAPS:
        counts = [s["overlap"][group]["count"] for s in summary.values() if group in s["overlap"]]
        if counts:
            rows.append([f"overlap {group} ({counts[0]} pairs)"])
            rows += [_row(m, summary[n]["overlap"], group) for n, m in methods.items()]
    return Table(title, NOTE, HEAD, rows)


def yaw_table(title: str, methods: Mapping[str, Method], summary: Mapping[str, Json]) -> Table:
    """Rotation errors by true relative yaw."""
    classes = list(dict.fromkeys(name for s in summary.values() for name in s["yaw"]))
    rows = []
    for name, method in methods.items():
        found = summary[name]["yaw"]
        rows.append([method.label, *(_yaw_cell(found[c]) for c in classes)])
    return Table(f"{title}: by true yaw", YAW_NOTE, ("method", *classes), rows)


def _row(method: Method, found: Mapping[str, Json], group: str) -> list[str]:
    s = found[group]
    seconds = s["match_seconds"]
    return [
        method.label,
        *(pose_cell(s["top"][k]["rotation_deg"], s["top"][k]["translation_m"]) for k in TOP),
        pose_cell(s["median"]["rotation_deg"], s["median"]["translation_m"]),
        f"{s['top']['1']['centroid_m']:.2f}",
        f"{s['recall']['1']:.2f}",
        f"{s['recall']['5']:.2f}",
        str(s["without_candidates"]),
        "-" if seconds is None else f"{seconds:.2f}",
    ]


def _yaw_cell(found: Json) -> str:
    return f"{found['top']['1']['rotation_deg']:.1f} ({found['recall']['1']:.2f})"
