"""Stored answers against ground truth: rows a pair and a set, means over groups of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmark.methods.interface import Answer, Placement
from benchmark.pairs import Pair
from benchmark.store import Record
from benchmark.tasks import PairTask, SetTask
from fewview.evaluation.calibration import calibration_of
from fewview.evaluation.gauge import absolute_errors
from fewview.evaluation.metrics import within
from fewview.evaluation.overlap import by_class
from fewview.evaluation.pairs import score_pairs, summarise_pairs

Json = dict[str, Any]

OVERLAPS: Mapping[str, Callable[[Json], bool]] = {
    ">= 10 %": lambda row: bool(row["overlap"] >= 0.1),
    "< 10 %": lambda row: bool(row["overlap"] < 0.1),
    "< 1 %": lambda row: bool(row["overlap"] < 0.01),
    "> 50 %": lambda row: bool(row["overlap"] > 0.5),
    "all": lambda row: True,
}
"""Overlap classes of the protocol; pairs over one half show that a method is set up right."""
YAW_STEP_DEG = 45


def yaw_classes() -> dict[str, Callable[[Json], bool]]:
    """Classes of the true relative yaw, 45 degrees each."""

    def inside(low: int) -> Callable[[Json], bool]:
        return lambda row: min(row["yaw_deg"], 179.999) // YAW_STEP_DEG == low // YAW_STEP_DEG

    steps = range(0, 180, YAW_STEP_DEG)
    return {f"{low}-{low + YAW_STEP_DEG} deg": inside(low) for low in steps}


def pair_row(task: PairTask, pair: Pair) -> Json:
    """Errors of the candidates of one method for one pair."""
    record: Record[Answer] = task.store.read(task.path)
    answer = record.answer or Answer()
    told: Json = {
        "source": pair.source,
        "target": pair.target,
        "selected": 0 if answer.candidates else None,
        "candidates": [
            {
                "rank": rank,
                "target_T_source": candidate.target_T_source,
                "probability": candidate.probability,
            }
            for rank, candidate in enumerate(answer.candidates)
        ],
    }
    truth = {name: task.scene.truth[name] for name in (pair.source, pair.target)}
    [row] = score_pairs([told], truth, centroids={pair.source: np.array(pair.centroid)})
    return row | {
        "scene": pair.scene,
        "overlap": pair.overlap,
        "yaw_deg": pair.yaw_deg,
        "error": record.error,
        "seconds": sum(record.seconds.values()),
        "match_seconds": record.seconds.get("match"),
    }


def summarise(rows: Sequence[Json], groups: Mapping[str, Callable[[Json], bool]]) -> Json:
    """Means of pair rows by group; groups without pairs are left out."""
    members = {name: [row for row in rows if fits(row)] for name, fits in groups.items()}
    return {name: _pairs(group) for name, group in members.items() if group}


def _pairs(rows: Sequence[Json]) -> Json:
    summary = summarise_pairs(rows)
    del summary["by_overlap"]
    told = [row["match_seconds"] for row in rows if row["match_seconds"] is not None]
    return {
        **summary,
        "broken": sum(row["error"] is not None for row in rows),
        "match_seconds": float(np.median(told)) if told else None,
    }


def best_ranks(rows: Sequence[Json], k: int = 5) -> Json:
    """How often the candidate with the smallest rotation error has rank 0, 1, ... (the paper's
    distribution); pairs without candidates are counted apart."""
    answered = [row["candidates"][:k] for row in rows if row["candidates"]]
    best = [int(np.argmin([c["rotation_deg"] for c in found])) for found in answered]
    shares = np.bincount(best, minlength=k) / max(len(best), 1)
    return {"answered": len(best), "of": len(rows), "shares": shares.tolist()}


def set_row(task: SetTask, overlap: Mapping[str, float]) -> Json:
    """Errors of one multi-scan method on one set, after one gauge alignment; beside each scan its
    largest ``overlap`` with another of the set."""
    record: Record[list[Placement | None]] = task.store.read(task.path)
    placements = record.answer or [None] * len(task.names)
    truth = np.stack([task.scene.truth[name] for name in task.names])
    errors = absolute_errors(truth, task.largest())
    right = within(errors.rotation_deg, errors.translation_m)
    return {
        "scene": task.scene.name,
        "size": len(task.names),
        "scans": [
            {
                "name": name,
                "placed": bool(errors.placed[i]),
                "rotation_deg": float(errors.rotation_deg[i]),
                "translation_m": float(errors.translation_m[i]),
                "right": bool(right[i]),
                "agreeing": bool(errors.agreeing[i]),
                "overlap": overlap[name],
                "probability": _probability(placements[i]),
            }
            for i, name in enumerate(task.names)
        ],
        "agreeing": int(errors.agreeing.sum()),
        "error": record.error,
        "cpu_seconds": task.seconds(),
    }


def summarise_sets(rows: Sequence[Json]) -> Json:
    """Means over all scans of sets of one size, as in the paper's few-view table."""
    scans = [scan for row in rows for scan in row["scans"]]
    told = [scan for scan in scans if scan["placed"] and scan["probability"] is not None]
    return {
        "sets": len(rows),
        "scans": len(scans),
        "rotation_deg": _mean(scans, "rotation_deg"),
        "translation_m": _mean(scans, "translation_m"),
        "right": _mean(scans, "right"),
        "unplaced": sum(not scan["placed"] for scan in scans),
        "agreeing": sum(row["agreeing"] for row in rows),
        "wrong_and_sure": sum(not s["right"] and s["probability"] > 0.5 for s in told),
        "broken": sum(row["error"] is not None for row in rows),
        "cpu_seconds": _mean(rows, "cpu_seconds"),
        "calibration": calibration_of(told),
        "calibration_in_component": calibration_of(told, "agreeing"),
        "by_overlap": {
            name: {"scans": len(members), "right": _mean(members, "right")}
            for name, members in by_class(scans).items()
        },
    }


def _probability(placement: Placement | None) -> float | None:
    return None if placement is None else placement.probability


def _mean(rows: Sequence[Json], key: str) -> float:
    return float(np.mean([row[key] for row in rows]))
