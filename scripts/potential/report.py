"""What fitted models say of samples that they do not know."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fewview.together import PotentialModel
from fewview.types import Array
from potential.fit import fitted, probabilities
from potential.samples import Sample

FOLDS = 4

Json = dict[str, Any]


def held_out(samples: Sequence[Sample]) -> Json:
    """What models fitted without a quarter of the scenes say of it."""
    scenes = sorted({sample.scene for sample in samples})
    judged = []
    for fold in range(FOLDS):
        out = set(scenes[fold::FOLDS])
        model = fitted([s for s in samples if s.scene not in out])
        judged += [(model, s) for s in samples if s.scene in out]
    return told(judged)


def told(judged: Sequence[tuple[PotentialModel, Sample]]) -> Json:
    """What models say of samples, by kind of set and number of scans beside."""
    rows: dict[str, list[tuple[Any, ...]]] = {}
    for model, sample in judged:
        p = probabilities(model, sample)
        best = int(p[1:].argmax())
        chance = p[1:][sample.right].sum() if sample.right.any() else p[0]
        row = sample.right.any(), sample.right[best], p[1 + best], chance
        rows.setdefault(sample.kind, []).append(row)
    return {name: _summary(np.array(found)) for name, found in sorted(rows.items())}


def _summary(rows: Array) -> Json:
    proposed_right, best_right, probability, chance = rows.T
    sure = probability > 0.5
    return {
        "samples": len(rows),
        "right_proposed": round(float(proposed_right.mean()), 3),
        "best_right": round(float(best_right.mean()), 3),
        "above_half": round(float(sure.mean()), 3),
        "above_half_and_right": round(float((sure * best_right).mean()), 3),
        "mean_probability": round(float(probability.mean()), 3),
        "log_loss": round(float(-np.log(np.maximum(chance, 1e-9)).mean()), 3),
    }
