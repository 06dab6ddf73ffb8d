"""How many matched features agree with a pose, and how firmly those hold it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fewview.completion import KINDS, OBSERVED_KINDS
from fewview.matching.consistency import CandidateMatches
from fewview.types import Array, BoolArray, IntArray, Representation

OBSERVED = frozenset(kind.name for kind in OBSERVED_KINDS)


@dataclass(frozen=True)
class Support:
    """Agreeing features of K poses.

    Attributes:
        per_kind: (K,) number of different source features of each kind.
        points: (K,) how many of them are exact points.
        columns: named quantities (K,) for the probability; ``share``, ``lead`` and ``spread`` are
            of seen features alone.
    """

    per_kind: dict[str, IntArray]
    points: Array
    columns: dict[str, Array]

    @staticmethod
    def of(matches: CandidateMatches, support: BoolArray) -> Support:
        """Count what agrees: (K, m) which of m correspondences support each pose."""
        per_kind = {kind.name: np.zeros(len(support), dtype=np.int64) for kind in KINDS}
        points = np.zeros(len(support))
        for i, (name, scales) in enumerate(matches.kinds.items()):
            per_kind[name] = _different(matches, support, i)
            points += per_kind[name] * scales.fixed_point
        names = np.array(list(matches.kinds), dtype=str)
        seen = np.isin(names, list(OBSERVED))[matches.kind] if len(names) else matches.kind > 0
        logarithm = np.log1p(points)
        columns = {
            **{name: np.log1p(count) for name, count in per_kind.items()},
            "share": points / (10.0 + seen.sum()),
            "lead": np.clip(logarithm - _best_other(logarithm), -2.0, 2.0),
            "spread": np.array([_spread(matches.source[row & seen]) for row in support]),
        }
        return Support(per_kind, points, columns)

    def by_representation(self, k: int) -> dict[Representation, int]:
        """Numbers of pose ``k`` as the report counts them."""
        counts = dict.fromkeys(Representation, 0)
        for kind in KINDS:
            counts[kind.representation] += int(self.per_kind[kind.name][k])
        return counts


def _different(matches: CandidateMatches, support: BoolArray, kind: int) -> IntArray:
    own = matches.kind == kind
    return np.array([len(np.unique(matches.indices[s & own, 0])) for s in support], dtype=np.int64)


def _spread(points: Array) -> float:
    """How well points pin down a rotation: their second largest standard deviation, metres."""
    if len(points) < 3:
        return 0.0
    return float(np.sqrt(max(np.linalg.eigvalsh(np.cov(points.T))[1], 0.0)))


def _best_other(values: Array) -> Array:
    """For each entry the largest of the others, 0 when alone."""
    return np.array([np.delete(values, k).max(initial=0.0) for k in range(len(values))])
