"""Means over the rows of the few-view benchmark."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fewview.evaluation.calibration import expected_calibration_error, reliability
from fewview.evaluation.overlap import CLASSES, overlap_class

Json = dict[str, Any]
MEASURES = ("wall_s", "cpu_s", "peak_mb")


def summarise(rows: Sequence[Json], peer: str) -> Json:
    """Scans by scene, kind and size; pairs by scene and kind; probabilities by method.

    Args:
        rows: one scored answer each, as `few_view.score` makes them.
        peer: the method that time and errors are put in relation to, on the same sets.
    """
    return {
        "scans": _with_ratios(_grouped(rows, ("scene", "kind", "size", "method"), _scans), peer),
        "pairs": _grouped(rows, ("scene", "kind", "method"), _pairs),
        "calibration": [
            *_grouped(rows, ("scene", "method"), _calibrations),
            *({"scene": "all", **group} for group in _grouped(rows, ("method",), _calibrations)),
        ],
    }


def _grouped(
    rows: Sequence[Json], names: Sequence[str], reduce: Callable[[Sequence[Json]], Json]
) -> list[Json]:
    keys = dict.fromkeys(tuple(row[name] for name in names) for row in rows)
    return [
        dict(zip(names, key, strict=True))
        | reduce([row for row in rows if tuple(row[name] for name in names) == key])
        for key in keys
    ]


def _scans(rows: Sequence[Json]) -> Json:
    totals = [row["scores"]["absolute"] for row in rows]
    group: Json = {"sets": len(rows), "failures": sum(row["failed"] is not None for row in rows)}
    for name in ("rotation_deg", "translation_m", "within"):
        group[name] = float(np.mean([total[name] for total in totals]))
    for name in ("scans", "unplaced", "agreeing", "confidently_wrong"):
        group[name] = sum(total[name] for total in totals)
    for name in MEASURES:
        group[name] = _mean([row["measured"][name] for row in rows if row["measured"]])
    staged = [row["timings_s"] for row in rows if row["timings_s"]]
    stages = dict.fromkeys(stage for timings in staged for stage in timings)
    group["timings_s"] = {s: _mean([t[s] for t in staged if s in t]) for s in stages}
    return group


def _with_ratios(groups: list[Json], peer: str) -> list[Json]:
    peers = {(g["scene"], g["kind"], g["size"]): g for g in groups if g["method"] == peer}
    for group in groups:
        other = peers.get((group["scene"], group["kind"], group["size"]))
        group["ratio_to_peer"] = None if other is None else _ratios(group, other)
    return groups


def _ratios(group: Json, other: Json) -> Json:
    names = ("rotation_deg", "translation_m", *MEASURES)
    return {n: group[n] / other[n] if group[n] is not None and other[n] else None for n in names}


def _pairs(rows: Sequence[Json]) -> Json:
    """Recall@1 and @5 of all pairs by overlap class, and how many selected ones are right."""
    pairs = [pair for row in rows for pair in row["scores"]["pairs"]]
    classes = {}
    for _, name in CLASSES:
        members = [pair for pair in pairs if overlap_class(pair["overlap"]) == name]
        if members:
            classes[name] = {
                "count": len(members),
                "@1": _recall(members, 1),
                "@5": _recall(members, 5),
            }
    summaries = [row["scores"]["pair_summary"] for row in rows]
    return {
        "count": len(pairs),
        "selected": sum(summary["selected"] for summary in summaries),
        "selected_right": sum(summary["selected_right"] for summary in summaries),
        "recall": classes,
    }


def _recall(pairs: Sequence[Json], k: int) -> float:
    return float(np.mean([any(c["right"] for c in pair["candidates"][:k]) for pair in pairs]))


def _calibrations(rows: Sequence[Json]) -> Json:
    scans = [scan for row in rows for scan in row["scores"]["scans"] if scan["placed"]]
    pairs = [pair for row in rows for pair in row["scores"]["pairs"]]
    candidates = [candidate for pair in pairs for candidate in pair["candidates"]]
    return {"scans": _calibration(scans), "candidates": _calibration(candidates)}


def _calibration(answers: Sequence[Json]) -> Json | None:
    """Reliability of all answers that carry a probability, pooled; None without any."""
    told = [answer for answer in answers if answer["probability"] is not None]
    if not told:
        return None
    probability = np.array([answer["probability"] for answer in told])
    right = np.array([answer["right"] for answer in told])
    return {
        "count": len(told),
        "ece": expected_calibration_error(probability, right),
        "brier": float(np.mean((probability - right) ** 2)),
        "bins": [vars(group) for group in reliability(probability, right)],
    }


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None
