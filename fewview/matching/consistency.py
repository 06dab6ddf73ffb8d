"""The consistency matrix over candidate correspondences (supplementary, spectral matching).

C(c, c') = s_c s_c' g_cc', where g compares one length and three angles that a rigid motion keeps:

    l = |p - p'|, theta_1 = angle(n, n'), theta_2 = angle(n, p - p'), theta_3 = angle(n', p - p')

    g = exp(-(l_1 - l_2)^2 / 2 gamma_2^2 - sum_i (theta_i,1 - theta_i,2)^2 / 2 gamma_{i+2}^2)

Every kind of feature has its own gammas; between kinds their variances are averaged. An angle with
an unknown normal says nothing. Entries under `MIN_ENTRY` are zero, so most pairs are settled by
their length alone and never see an angle.

Between levelled scans the angles are turns about the vertical, with a sign: a motion that keeps the
vertical keeps them too, and a mirrored set of matches, which all else lets pass, does not.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from fewview.types import (
    Array,
    BoolArray,
    CompletedScan,
    Correspondences,
    FloatArray,
    IntArray,
    Scales,
)

MIN_ENTRY = 0.1
MIN_LENGTH_M = 0.05
UPRIGHT_COS = 0.7
BLOCK = 256


@dataclass(frozen=True)
class CandidateMatches:
    """Candidate correspondences of all kinds, stacked.

    Attributes:
        source, target: (m, 3) positions; source_normals, target_normals: (m, 3), zero if unknown.
        similarity: (m,) s_c.
        kinds: the feature kinds and their scales; kind: (m,) index into them.
        indices: (m, 2) into the feature sets of that kind.
        up: (2, 3) up direction in the source and in the target when the scans count as levelled.
    """

    source: Array
    target: Array
    source_normals: Array
    target_normals: Array
    similarity: FloatArray
    kinds: Mapping[str, Scales]
    kind: IntArray
    indices: IntArray
    up: Array | None = None

    def __len__(self) -> int:
        return len(self.source)

    @property
    def normals_known(self) -> BoolArray:
        """(m,) whether both features have a normal."""
        return np.asarray(self.source_normals.any(axis=1) & self.target_normals.any(axis=1))

    def scale(self, name: str) -> FloatArray:
        """(m,) value of a `Scales` field for each correspondence."""
        values = np.array([getattr(s, name) for s in self.kinds.values()], dtype=np.float32)
        return np.asarray(values[self.kind])


def stack(
    source: CompletedScan,
    target: CompletedScan,
    matches: list[Correspondences],
    limit: int,
    levelled: bool = False,
) -> CandidateMatches:
    """Collect correspondences of all kinds, at most ``limit``, best similarity first.

    Args:
        source, target: the scans.
        matches: of each kind.
        limit: how many are kept.
        levelled: whether poses have to keep the vertical.
    """
    counts = np.array([len(m) for m in matches], dtype=np.int64)
    kind = np.repeat(np.arange(len(matches)), counts)
    indices = np.concatenate([np.zeros((0, 2), np.int64), *(m.indices for m in matches)])
    similarity = np.concatenate([np.zeros(0, np.float32), *(m.similarity for m in matches)])
    order = np.argsort(-similarity, kind="stable")[:limit]
    kind, indices, similarity = kind[order], indices[order], similarity[order]
    kinds = {m.kind: m.scales for m in matches}
    columns = [np.zeros((len(order), 3)) for _ in range(4)]
    for i, name in enumerate(kinds):
        rows = kind == i
        for side, scan in enumerate((source, target)):
            features = scan.features[name]
            columns[side][rows] = features.positions[indices[rows, side]]
            columns[side + 2][rows] = features.normals[indices[rows, side]]
    p, q, n, m = columns
    up = np.stack([scan.levelling.level_R_scan[2] for scan in (source, target)])
    return CandidateMatches(p, q, n, m, similarity, kinds, kind, indices, up if levelled else None)


def joined(first: CandidateMatches, second: CandidateMatches) -> CandidateMatches:
    """Candidate matches of different kinds together, ``first`` before ``second``; up as there."""

    def both(name: str) -> Any:
        return np.concatenate([getattr(first, name), getattr(second, name)])

    return CandidateMatches(
        both("source"),
        both("target"),
        both("source_normals"),
        both("target_normals"),
        both("similarity"),
        {**first.kinds, **second.kinds},
        np.concatenate([first.kind, second.kind + len(first.kinds)]),
        both("indices"),
        second.up,
    )


def consistency_matrix(matches: CandidateMatches) -> sparse.csr_matrix:
    """The symmetric (m, m) matrix C with zero diagonal."""
    rows, columns, values = [], [], []
    for i, j in _compatible_lengths(matches):
        geometry = _geometry_score(matches, i, j)
        keep = geometry > MIN_ENTRY
        i, j = i[keep], j[keep]
        rows.append(i)
        columns.append(j)
        values.append(geometry[keep] * matches.similarity[i] * matches.similarity[j])
    i, j = np.concatenate(rows), np.concatenate(columns)
    size = len(matches)
    upper = sparse.csr_matrix((np.concatenate(values), (i, j)), shape=(size, size))
    return (upper + upper.T).tocsr()


def _compatible_lengths(matches: CandidateMatches) -> Iterator[tuple[IntArray, IntArray]]:
    """Pairs i < j, block by block, whose length term alone leaves the entry above the minimum and
    which do not share a feature."""
    p, q = matches.source.astype(np.float32), matches.target.astype(np.float32)
    gamma = matches.scale("length_m") ** 2
    limit = -np.log(MIN_ENTRY)
    for start in range(0, max(len(matches), 1), BLOCK):
        stop = min(start + BLOCK, len(matches))
        here = slice(start, stop)
        length_p, length_q = _lengths(p[here], p[start:]), _lengths(q[here], q[start:])
        variance = gamma[here, None] + gamma[None, start:]
        fits = (length_p - length_q) ** 2 < limit * variance
        fits &= np.minimum(length_p, length_q) > MIN_LENGTH_M
        fits &= np.arange(stop - start)[:, None] < np.arange(len(matches) - start)[None]
        i, j = np.nonzero(fits)
        i, j = i + start, j + start
        same_kind = matches.kind[i] == matches.kind[j]
        shared = (matches.indices[i] == matches.indices[j]).any(axis=1)
        keep = ~(same_kind & shared)
        yield i[keep], j[keep]


def _lengths(a: FloatArray, b: FloatArray) -> FloatArray:
    squared = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1)[None] - 2.0 * (a @ b.T)
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)))


def _geometry_score(matches: CandidateMatches, i: IntArray, j: IntArray) -> FloatArray:
    sides = (
        (matches.source, matches.source_normals),
        (matches.target, matches.target_normals),
    )
    ups = (None, None) if matches.up is None else matches.up.astype(np.float32)
    quantities = [
        _invariants(points.astype(np.float32), normals.astype(np.float32), i, j, up)
        for (points, normals), up in zip(sides, ups, strict=True)
    ]
    known = _angles_known(matches)
    used = (np.ones(len(i), dtype=bool), known[i] & known[j], known[i], known[j])
    names = ("length_m", "normal_angle", "direction_angle", "direction_angle")
    exponent = np.zeros(len(i), dtype=np.float32)
    for name, use, a, b in zip(names, used, *quantities, strict=True):
        gamma = matches.scale(name) ** 2
        change = a - b
        if matches.up is not None and name != "length_m":
            change = np.remainder(change + np.pi, 2.0 * np.pi) - np.pi
        exponent += use * change**2 / (gamma[i] + gamma[j])
    return np.exp(-exponent)


def _angles_known(matches: CandidateMatches) -> BoolArray:
    """(m,) where both normals are known and, between levelled scans, not nearly vertical."""
    if matches.up is None:
        return matches.normals_known
    lean = [matches.source_normals @ matches.up[0], matches.target_normals @ matches.up[1]]
    return np.asarray(matches.normals_known & (np.abs(lean).max(axis=0) < UPRIGHT_COS))


def _invariants(
    points: FloatArray, normals: FloatArray, i: IntArray, j: IntArray, up: FloatArray | None
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    step = points[i] - points[j]
    length = np.sqrt((step**2).sum(axis=1))
    step /= np.maximum(length, 1e-9)[:, None]
    return (
        length,
        _angle(normals[i], normals[j], up),
        _angle(normals[i], step, up),
        _angle(normals[j], step, up),
    )


def _angle(a: FloatArray, b: FloatArray, up: FloatArray | None) -> FloatArray:
    """Angles 0..pi between unit vectors, or -pi..pi about ``up`` from ``a`` to ``b``."""
    cosine = (a * b).sum(axis=1)
    if up is None:
        return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return np.asarray(np.arctan2(np.cross(a, b) @ up, cosine - (a @ up) * (b @ up)))
