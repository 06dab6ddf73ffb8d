"""Four-point congruent sets: all quadruples of one sample that a rigid motion takes to a base.

4PCS (Aiger, Mitra and Cohen-Or, SIGGRAPH 2008): a base is four roughly coplanar points of the
target; its two diagonals cross at ratios that rigid motions preserve. Super4PCS (Mellado, Aiger
and Mitra, SGP 2014) finds congruent quadruples in time linear in their number: pairs at a given
distance come from an index, crossing points are joined in a second one, and the angle between
the diagonals is checked as well. Here the indices are the sorted table of all pair distances and
a k-d tree.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from fewview.types import Array, BoolArray, IntArray

TRIANGLES = 1000
"""Random triangles of which a base takes the widest."""
MIN_SIDE_SHARE = 0.2
"""The fourth point keeps this share of the largest base side from the other three."""
MAX_NORMAL_DEG = 30.0
"""How far the angle between the normals of two points may be from that of the base."""
MAX_DIAGONAL_DEG = 5.0
"""How far the angle between the diagonals may be from that of the base."""
MAX_JOINS = 40_000
"""Crossing points that are looked at for one base."""


@dataclass(frozen=True)
class Sample:
    """Points of a scan with an index of their pairs.

    Attributes:
        points: (n, 3) metres.
        normals: (n, 3) unit.
        pairs: (m, 2) all pairs i < j by growing distance.
        distances: (m,) of the pairs.
    """

    points: Array
    normals: Array
    pairs: IntArray
    distances: Array

    @staticmethod
    def of(points: Array, normals: Array) -> Sample:
        """Index the pairs of (n, 3) points with (n, 3) normals."""
        pairs = np.stack(np.triu_indices(len(points), 1), axis=1)
        distances = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
        order = np.argsort(distances, kind="stable")
        return Sample(points, normals, pairs[order], distances[order])

    def pairs_at(self, distance: float, tolerance: float) -> IntArray:
        """Pairs (k, 2) at a distance, in both directions."""
        bounds = (distance - tolerance, distance + tolerance)
        first, last = np.searchsorted(self.distances, bounds)
        found = self.pairs[first:last]
        return np.concatenate([found, found[:, ::-1]])


@dataclass(frozen=True)
class Base:
    """Four roughly coplanar points a, b, c, d whose diagonals ab and cd cross.

    Attributes:
        points: (4, 3).
        normals: (4, 3).
        ratios: (2,) where the crossing lies on ab and on cd, 0..1.
    """

    points: Array
    normals: Array
    ratios: Array


def wide_base(
    sample: Sample, max_side: float, tolerance: float, rng: np.random.Generator
) -> Base | None:
    """A base as wide as `TRIANGLES` tries give, with sides up to ``max_side``.

    None when no fourth point within ``tolerance`` of the triangle's plane makes the diagonals
    cross.
    """
    points = sample.points
    first = int(rng.integers(len(points)))
    others = rng.integers(len(points), size=(TRIANGLES, 2))
    arms = points[others] - points[first]
    inside = (np.linalg.norm(arms, axis=-1) < max_side).all(axis=1)
    area = np.linalg.norm(np.cross(arms[:, 0], arms[:, 1]), axis=1) * inside
    widest = int(area.argmax())
    if area[widest] <= 0.0:
        return None
    chosen = np.array([first, *others[widest]])
    fourth = _fourth_point(points, points[chosen], max_side, tolerance)
    if fourth is None:
        return None
    quadruple = np.append(chosen, fourth)
    return _crossing(points[quadruple], sample.normals[quadruple])


def congruent_sets(base: Base, sample: Sample, tolerance: float) -> IntArray:
    """Quadruples (k, 4) of a sample that are congruent to a base, points within ``tolerance``."""
    diagonals = [_diagonals(base, sample, side, tolerance) for side in (0, 2)]
    if not all(map(len, diagonals)):
        return np.empty((0, 4), dtype=np.int64)
    starts, ends = ([sample.points[d[:, k]] for d in diagonals] for k in (0, 1))
    crossings = [a + ratio * (b - a) for a, b, ratio in zip(starts, ends, base.ratios, strict=True)]
    near = KDTree(crossings[0]).sparse_distance_matrix(
        KDTree(crossings[1]), tolerance, output_type="ndarray"
    )
    if len(near) > MAX_JOINS:
        near = near[:: len(near) // MAX_JOINS + 1]
    i, j = near["i"], near["j"]
    cosines = _cosines((ends[0] - starts[0])[i], (ends[1] - starts[1])[j])
    a, b, c, d = base.points
    angle = np.arccos(np.clip(_cosines(b - a, d - c), -1.0, 1.0))
    kept = np.abs(np.arccos(np.clip(cosines, -1.0, 1.0)) - angle) < np.radians(MAX_DIAGONAL_DEG)
    return np.hstack([diagonals[0][i[kept]], diagonals[1][j[kept]]])


def _diagonals(base: Base, sample: Sample, side: int, tolerance: float) -> IntArray:
    """Pairs (k, 2) as far apart, and with normals at the same angle, as a diagonal of a base."""
    a, b = base.points[side : side + 2]
    pairs = sample.pairs_at(float(np.linalg.norm(b - a)), tolerance)
    wanted = _angle(base.normals[side], base.normals[side + 1])
    found = _angle(sample.normals[pairs[:, 0]], sample.normals[pairs[:, 1]])
    alike: BoolArray = np.abs(found - wanted) < np.radians(MAX_NORMAL_DEG)
    return np.asarray(pairs[alike])


def _fourth_point(points: Array, triangle: Array, max_side: float, tolerance: float) -> int | None:
    """The point nearest to the triangle's plane, away from its corners and within the base."""
    normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
    offset = np.abs((points - triangle[0]) @ normal) / np.linalg.norm(normal)
    apart = np.linalg.norm(points[:, None] - triangle, axis=-1)
    allowed = (apart > MIN_SIDE_SHARE * max_side).all(axis=1) & (apart < max_side).all(axis=1)
    offset[~(allowed & _crosses(points, triangle, normal))] = np.inf
    best = int(offset.argmin())
    return best if offset[best] < tolerance else None


def _crosses(points: Array, triangle: Array, normal: Array) -> BoolArray:
    """Which (n, 3) points make a convex quadrilateral with a triangle.

    In barycentric coordinates those are the points for which exactly one is negative.
    """
    a, b, c = triangle
    areas = [np.cross(q - p, points - p) @ normal for p, q in ((a, b), (b, c), (c, a))]
    return np.asarray((np.stack(areas) < 0.0).sum(axis=0) == 1)


def _crossing(points: Array, normals: Array) -> Base | None:
    """Order four convex coplanar points into crossing diagonals."""
    for order in ([0, 1, 2, 3], [0, 2, 1, 3], [0, 3, 1, 2]):
        a, b, c, d = points[order]
        columns = np.stack([b - a, c - d], axis=1)
        ratios, *_ = np.linalg.lstsq(columns, c - a, rcond=None)
        if ((ratios > 0.0) & (ratios < 1.0)).all():
            return Base(points[order], normals[order], ratios)
    return None


def _angle(a: Array, b: Array) -> Array:
    return np.asarray(np.arccos(np.clip((a * b).sum(axis=-1), -1.0, 1.0)))


def _cosines(a: Array, b: Array) -> Array:
    lengths = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    return np.asarray((a * b).sum(axis=-1) / lengths)
