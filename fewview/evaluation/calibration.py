"""Do probabilities mean what they say? Reliability bins and the expected calibration error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fewview.types import Array, BoolArray

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
    index = np.minimum((probability * bins).astype(np.int64), bins - 1)
    groups = [(b, index == b) for b in range(bins)]
    return tuple(
        Bin(
            b / bins,
            (b + 1) / bins,
            int(members.sum()),
            float(probability[members].mean()),
            float(right[members].mean()),
        )
        for b, members in groups
        if members.any()
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


def calibration_of(rows: Sequence[Json]) -> Json | None:
    """Reliability of the rows that carry a ``probability``, by their ``right``; None when none
    does."""
    told = [row for row in rows if row.get("probability") is not None]
    if not told:
        return None
    bins = reliability(
        np.array([row["probability"] for row in told]), np.array([row["right"] for row in told])
    )
    return {
        "count": len(told),
        "ece": calibration_error(bins),
        "bins": [vars(group) for group in bins],
    }
