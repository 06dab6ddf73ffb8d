"""Errors of a report's pose candidates: top-k as in the paper, recall@k, the selected one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from fewview.evaluation.metrics import (
    best_of_top_k,
    orthonormal,
    relative,
    rotation_error_deg,
    translation_error_at_m,
    translation_error_m,
    within,
)
from fewview.evaluation.overlap import by_class
from fewview.types import Array

Json = dict[str, Any]
Overlaps = Mapping[tuple[str, str], float]

TOP_K = (1, 3, 5)
"""The k for which results are shown."""


def score_pairs(
    pairs: Sequence[Json],
    truth: Mapping[str, Array],
    overlaps: Overlaps | None = None,
    centroids: Mapping[str, Array] | None = None,
) -> list[Json]:
    """Errors of every candidate of every pair whose two scans have a true pose.

    Args:
        pairs: the ``pairs`` of a report.
        truth: (4, 4) camera-to-world by name.
        overlaps: true overlap by pair of names in either order.
        centroids: (3,) centroid by name, in the scan's frame.
    """
    rows = []
    for pair in pairs:
        source, target = pair["source"], pair["target"]
        if source not in truth or target not in truth:
            continue
        expected = relative(*orthonormal(np.stack([truth[source], truth[target]])))
        centroid = None if centroids is None else centroids[source]
        row: Json = {
            "source": source,
            "target": target,
            "selected": pair.get("selected"),
            "identity": _errors(expected, np.eye(4), centroid),
            "candidates": [
                _candidate(candidate, expected, centroid)
                for candidate in sorted(pair["candidates"], key=lambda c: c["rank"])
            ],
        }
        if overlaps is not None:
            known = (source, target) if (source, target) in overlaps else (target, source)
            row["overlap"] = float(overlaps[known])
        rows.append(row)
    return rows


def summarise_pairs(rows: Sequence[Json]) -> Json:
    """Means (and top-1 medians) over scored pairs, and by overlap class where overlaps are known.

    A pair without candidates counts with the identity's errors in ``top`` and as a miss in
    ``recall``, and is counted in ``without_candidates``.
    """
    summary = _summary(rows)
    known = by_class([row for row in rows if "overlap" in row])
    summary["by_overlap"] = {name: _summary(group) for name, group in known.items()}
    return summary


def _summary(rows: Sequence[Json]) -> Json:
    chosen = [_selected(row) for row in rows if row["selected"] is not None]
    return {
        "count": len(rows),
        "without_candidates": sum(not row["candidates"] for row in rows),
        "selected": len(chosen),
        "selected_right": sum(bool(candidate["right"]) for candidate in chosen),
        "recall": {str(k): _recall(rows, k) for k in TOP_K} if rows else None,
        "top": {str(k): _over(rows, k, np.mean) for k in TOP_K} if rows else None,
        "median": _over(rows, 1, np.median) if rows else None,
    }


def _recall(rows: Sequence[Json], k: int) -> float:
    return float(np.mean([any(c["right"] for c in row["candidates"][:k]) for row in rows]))


def _over(rows: Sequence[Json], k: int, reduce: Callable[[Sequence[float]], Any]) -> Json:
    """Errors of the best of the first k candidates, reduced over all pairs."""
    best = [_best(row, k) for row in rows]
    keys = [key for key in best[0] if key.endswith(("_deg", "_m"))]
    return {key: float(reduce([errors[key] for errors in best])) for key in keys}


def _best(row: Json, k: int) -> Json:
    index = best_of_top_k([c["rotation_deg"] for c in row["candidates"]], k)
    chosen: Json = row["identity"] if index is None else row["candidates"][index]
    return chosen


def _selected(row: Json) -> Json:
    chosen: Json = next(c for c in row["candidates"] if c["rank"] == row["selected"])
    return chosen


def _candidate(candidate: Json, expected: Array, centroid: Array | None) -> Json:
    pose = np.array(candidate["target_T_source"], dtype=np.float64)
    errors = _errors(expected, pose, centroid)
    return {"rank": candidate["rank"], "probability": candidate.get("probability"), **errors}


def _errors(expected: Array, pose: Array, centroid: Array | None) -> Json:
    rotation = rotation_error_deg(expected, pose)
    translation = translation_error_m(expected, pose)
    errors: Json = {
        "rotation_deg": float(rotation),
        "translation_m": float(translation),
        "right": bool(within(rotation, translation)),
    }
    if centroid is not None:
        errors["centroid_m"] = float(translation_error_at_m(expected, pose, centroid))
    return errors
