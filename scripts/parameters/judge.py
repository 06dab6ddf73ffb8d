"""What learned values change on validation pairs, and whether that is an improvement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.stats import binomtest

from fewview.config import RefinementConfig
from fewview.evaluation.metrics import (
    RIGHT_DEG,
    RIGHT_M,
    rotation_error_deg,
    translation_error_m,
    within,
)
from fewview.evaluation.relations import perturbed
from fewview.matching.completed import completion_poses
from fewview.matching.consistency import consistency_matrix
from fewview.matching.spectral import top_poses
from fewview.refinement.relations import RelationPredictor
from fewview.types import Array, BoolArray, Scales
from parameters.pairs import Part, ScannedRoom, ScanPair
from parameters.problems import refined

Json = dict[str, Any]

OVERLAPPING = 0.1
"""Pairs from this overlap on count as overlapping (paper, Sec. 4)."""
STARTS = 4
"""Perturbed starts of each pair."""
FARTHEST = {"far": (30.0, 0.5), "near": (10.0, 0.15)}
"""How many degrees and metres along each axis starts are off the truth at most: as where the paper
predicts relations, and as where good candidates lie."""
NOTICED = 0.1
"""A refined pair changes when its mean error does by this share of what still counts as right."""
CHANCE = 0.05
"""A gain counts when chance alone would give one as clear, or a loss, less often than this."""


def overlaps(rooms: Sequence[ScannedRoom]) -> Array:
    """(pairs,) true overlaps, in the order in which all else here goes through pairs."""
    return np.array([pair.overlap for room in rooms for pair in room.pairs])


def spectral_hits(
    rooms: Sequence[ScannedRoom], part: Part, kinds: Mapping[str, Scales] | None, count: int
) -> BoolArray:
    """(pairs, count) which of a spectral pass's candidates, best first, are right unrefined.

    Args:
        rooms: with their pairs.
        part: which pass.
        kinds: scales instead of the shipped ones.
        count: K.
    """
    out = np.zeros((sum(len(room.pairs) for room in rooms), count), dtype=bool)
    pairs = ((room, pair) for room in rooms for pair in room.pairs)
    for row, (room, pair) in zip(out, pairs, strict=True):
        poses = _spectral_poses(room, pair, part, kinds, count)
        truth = pair.target_T_source
        errors = rotation_error_deg(truth, poses), translation_error_m(truth, poses)
        row[: len(poses)] = within(*errors)
    return out


def refinement_errors(
    rooms: Sequence[ScannedRoom],
    predictor: RelationPredictor,
    config: RefinementConfig,
    farthest: tuple[float, float],
    seed: int,
) -> Array:
    """(pairs, `STARTS`, 2) degrees and metres off the truth after refinement.

    Args:
        rooms: with their pairs.
        predictor: of relations under the starts.
        config: without iterations the errors are those of the starts.
        farthest: degrees and metres by which starts are off the truth at most.
        seed: of the starts.
    """
    rng, out = np.random.default_rng(seed), []
    for room in rooms:
        for pair in room.pairs:
            truth = pair.target_T_source
            poses = np.stack([perturbed(truth, rng, *farthest) for _ in range(STARTS)])
            poses = refined(room, pair, poses, predictor, config)
            errors = rotation_error_deg(truth, poses), translation_error_m(truth, poses)
            out.append(np.stack(errors, axis=1))
    return np.array(out).reshape(-1, STARTS, 2)


def judged_spectral(old: BoolArray, learned: BoolArray, overlap: Array) -> Json:
    """Shares of pairs with a right candidate first and among all. Values are to be shipped when one
    of the two has clearly gained, and the other has not lost more pairs than it gained."""
    out: Json = {}
    for k in (1, old.shape[1]):
        a, b = (np.asarray(hits[:, :k].any(axis=1)) for hits in (old, learned))
        shares = {
            name: {"pairs": int(c.sum()), "old": _mean(a[c]), "learned": _mean(b[c])}
            for name, c in _classes(overlap).items()
        }
        out[f"top_{k}"] = shares | _compared(int((b & ~a).sum()), int((a & ~b).sum()))
    kept = all(part["better"] >= part["worse"] for part in out.values())
    return out | {"ship": kept and any(_gained(part) for part in out.values())}


def judged_regression(start: Array, old: Array, learned: Array, overlap: Array) -> Json:
    """Errors after refinement, (pairs, starts, 2) each. Values are to be shipped when clearly more
    pairs get better than worse and, whether scans overlap or not, no fewer poses are right."""
    out: Json = {}
    named = {"start": start, "old": old, "learned": learned}
    size = {name: _size(errors) for name, errors in named.items()}
    change = (size["learned"] - size["old"]).mean(axis=1)
    better, worse = change < -NOTICED, change > NOTICED
    for label, c in _classes(overlap).items():
        values = {
            name: {
                "mean_deg_m": errors[c].mean(axis=(0, 1)).round(3).tolist(),
                "median_deg_m": np.median(errors[c], axis=(0, 1)).round(3).tolist(),
                "right": _mean(within(errors[c, :, 0], errors[c, :, 1])),
                "worse_than_start": _mean(size[name][c] > size["start"][c]),
            }
            for name, errors in named.items()
        }
        counts = {
            "pairs": int(c.sum()),
            "better": int(better[c].sum()),
            "worse": int(worse[c].sum()),
        }
        out[label] = values | counts
    held = all(part["learned"]["right"] >= part["old"]["right"] for part in out.values())
    both = _compared(int(better.sum()), int(worse.sum()))
    return out | both | {"ship": held and _gained(both)}


def _spectral_poses(
    room: ScannedRoom, pair: ScanPair, part: Part, kinds: Mapping[str, Scales] | None, count: int
) -> Array:
    matches = pair.candidates(part)
    matches = matches if kinds is None else replace(matches, kinds=kinds)
    if part == "observed":
        found = top_poses(matches, consistency_matrix(matches), count)
        poses = [hypothesis.target_T_source for hypothesis in found]
    else:
        target = room.scans[pair.target]
        poses = [pose for pose, _ in completion_poses(target, matches, pair.source_lift, count)]
    return np.array(poses).reshape(-1, 4, 4)


def _size(errors: Array) -> Array:
    """(pairs, starts) of both errors together, in units of what still counts as right."""
    return np.asarray(errors[..., 0] / RIGHT_DEG + errors[..., 1] / RIGHT_M)


def _compared(better: int, worse: int) -> Json:
    """Counts, and how probable a split so uneven is by chance (sign test)."""
    chance = binomtest(better, better + worse).pvalue if better + worse else 1.0
    return {"better": better, "worse": worse, "by_chance": round(float(chance), 3)}


def _gained(counts: Json) -> bool:
    return bool(counts["better"] > counts["worse"] and counts["by_chance"] < CHANCE)


def _classes(overlap: Array) -> dict[str, BoolArray]:
    near = overlap >= OVERLAPPING
    return {"overlapping": near, "apart": ~near}


def _mean(values: Array | BoolArray) -> float:
    return round(float(np.mean(values)), 3) if values.size else 0.0
