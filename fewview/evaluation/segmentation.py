"""How well classes of pixels or cells are told: confusion counts and what follows from them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fewview.types import Array, IntArray


def confusion(truth: NDArray[Any], answer: NDArray[Any], classes: int) -> IntArray:
    """(classes, classes) counts, a row per true and a column per answered class.

    Args:
        truth: (...) integers 0..classes - 1.
        answer: (...) of the same shape.
        classes: how many there are.
    """
    pairs = classes * truth.astype(np.int64).ravel() + answer.astype(np.int64).ravel()
    counts = np.bincount(pairs, minlength=classes**2)
    return np.asarray(counts.reshape(classes, classes), np.int64)


def ious(counts: NDArray[Any]) -> Array:
    """(classes,) intersection over union of each class; NaN where it is neither true nor told."""
    hit = np.diagonal(counts).astype(np.float64)
    union = counts.sum(axis=0) + counts.sum(axis=1) - hit
    return np.asarray(np.divide(hit, union, out=np.full(len(hit), np.nan), where=union > 0))


def mean_iou(counts: NDArray[Any]) -> float:
    """Mean `ious` of the classes that occur in the truth, each counted the same; NaN for none."""
    true = counts.sum(axis=1) > 0
    return float(ious(counts)[true].mean()) if true.any() else float("nan")


def accuracy(counts: NDArray[Any]) -> float:
    """Share of right answers; NaN for none at all."""
    return float(np.trace(counts) / counts.sum()) if counts.any() else float("nan")
