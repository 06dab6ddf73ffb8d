"""Do probabilities mean what they say? Reliability bins and the expected calibration error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fewview.types import Array, BoolArray, FloatArray

Json = dict[str, Any]


@dataclass(frozen=True)
class Bin:
    """The answers whose probability fell into one interval.

    Attributes:
        low: lower end, included.
        high: upper end, excluded except for 1.
        count: number of answers.
        probability: their mean probability.
        right: share of them that were right.
    """

    low: float
    high: float
    count: int
    probability: float
    right: float


def reliability(probability: Array, right: BoolArray, bins: int = 10) -> tuple[Bin, ...]:
    """Group (n,) probabilities into equal intervals of 0..1; empty intervals are left out."""
    return bins_of(reliability_counts(probability, right, bins))


def reliability_counts(probability: Array | FloatArray, right: BoolArray, bins: int = 10) -> Array:
    """(bins, 3) number of answers, their summed probability, and how many of them were right.

    Those of several sets of answers add up; see `reliability` and `bins_of`.
    """
    index = np.minimum((probability * bins).astype(np.int64), bins - 1)
    columns = (np.ones(len(index)), probability, right)
    return np.stack([np.bincount(index, c, bins) for c in columns], axis=1)


def bins_of(counts: Array) -> tuple[Bin, ...]:
    """The intervals of `reliability_counts` that have answers."""
    return tuple(
        Bin(b / len(counts), (b + 1) / len(counts), int(count), total / count, right / count)
        for b, (count, total, right) in enumerate(counts.tolist())
        if count
    )


def expected_calibration_error(probability: Array, right: BoolArray, bins: int = 10) -> float:
    """`calibration_error` of (n,) probabilities and whether the answers were right."""
    return calibration_error(reliability(probability, right, bins))


def calibration_error(bins: Sequence[Bin]) -> float:
    """Mean distance between probability and share of right answers, weighted by bin counts.

    Zero for no answers at all.
    """
    total = sum(group.count for group in bins)
    gap = sum(group.count * abs(group.probability - group.right) for group in bins)
    return gap / total if total else 0.0


def calibration_of(rows: Sequence[Json], came_true: str = "right") -> Json | None:
    """Reliability of the rows that carry a ``probability``, by whether what it was said of came
    true (a key of the rows); None when none does."""
    told = [row for row in rows if row.get("probability") is not None]
    if not told:
        return None
    bins = reliability(
        np.array([row["probability"] for row in told]), np.array([row[came_true] for row in told])
    )
    return {
        "count": len(told),
        "ece": calibration_error(bins),
        "bins": [vars(group) for group in bins],
    }
