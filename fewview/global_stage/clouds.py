"""Surfaces of scans as they meet under given poses: neighbours that fit, points that judge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from fewview.geometry import se3
from fewview.global_stage.normal_equations import Facing
from fewview.types import Array, BoolArray, CompletedScan, IntArray

HELD_OUT = 5
"""One surface point in so many is kept from the fit and judges it."""

SAME_SIDE_COS = 0.7
"""Normals of neighbours differ by no more."""

POINT_SIGMA_M = 0.05
"""Error of a pair of neighbours close to the cameras; above the depth noise, since the errors of
neighbouring points are the same."""

NOISY_DEPTH_M = 2.5
"""Depth at which a point's variance has doubled: structured light errs with depth squared."""

MOST_QUERIES = 800
"""Points of one scan that look for neighbours in another."""

LEAST_QUERIES = 20
"""Scans of which fewer points meet do not overlap."""

JUDGED_M = 0.12
"""Held-out points judge by neighbours within this."""


@dataclass(frozen=True)
class Cloud:
    """The surface of a scan, in its frame.

    Attributes:
        points, normals: (n, 3) that fit; normals of points on planar patches are the patches'.
        noise: (n,) variance by depth, 1 close to the camera.
        tree: k-d tree of `points`.
        judging, judging_normals: (m, 3) those held out.
    """

    points: Array
    normals: Array
    noise: Array
    tree: cKDTree
    judging: Array
    judging_normals: Array

    @staticmethod
    def of(scan: CompletedScan) -> Cloud:
        """The cloud of a scan; every `HELD_OUT`-th point is held out."""
        points, normals = scan.surface.points, _steady_normals(scan)
        judging = np.arange(len(points)) % HELD_OUT == HELD_OUT - 1
        fit = points[~judging]
        return Cloud(
            points=fit,
            normals=normals[~judging],
            noise=1.0 + (fit[:, 2] / NOISY_DEPTH_M) ** 4,
            tree=cKDTree(fit),
            judging=points[judging],
            judging_normals=normals[judging],
        )


@dataclass(frozen=True)
class Overlap:
    """Points of one scan that look for neighbours in another.

    Attributes:
        source, target: which clouds.
        queries: indices into the points of the source.
    """

    source: int
    target: int
    queries: IntArray


def overlap(
    clouds: list[Cloud], poses: Array, source: int, target: int, radius: float
) -> Overlap | None:
    """An even selection of the source's points that meet the target, None where few do.

    Args:
        clouds: of m scans.
        poses: (m, 4, 4) world_T_scan.
        source, target: which clouds.
        radius: largest distance, metres.
    """
    target_T_source = se3.inverse(poses[target]) @ poses[source]
    ours = clouds[source]
    _, near = _nearest(ours.points, ours.normals, clouds[target], target_T_source, radius)
    met = np.flatnonzero(near)
    if len(met) < LEAST_QUERIES:
        return None
    even = np.linspace(0, len(met) - 1, min(len(met), MOST_QUERIES)).astype(np.int64)
    return Overlap(source, target, met[even])


def facing(
    clouds: list[Cloud], poses: Array, where: Overlap, radius: float, scale: float
) -> Facing:
    """The nearest neighbours of an overlap within ``radius``; ``scale`` of the loss in metres."""
    ours, theirs = clouds[where.source], clouds[where.target]
    target_T_source = se3.inverse(poses[where.target]) @ poses[where.source]
    p, n_p = ours.points[where.queries], ours.normals[where.queries]
    index, near = _nearest(p, n_p, theirs, target_T_source, radius)
    index = index[near]
    noise = ours.noise[where.queries[near]] + theirs.noise[index] - 1.0
    return Facing(
        source=where.source,
        target=where.target,
        p=p[near],
        n_p=n_p[near],
        q=theirs.points[index],
        n_q=theirs.normals[index],
        information=1.0 / (POINT_SIGMA_M**2 * noise),
        scale=scale,
    )


def held_out_gaps(source: Cloud, target: Cloud, target_T_source: Array) -> Array:
    """(m,) distance of the source's held-out points from the target's surface, the mean of those
    along both normals, metres; NaN where the surfaces do not meet."""
    points, normals = source.judging, source.judging_normals
    index, near = _nearest(points, normals, target, target_T_source, JUDGED_M)
    gap = se3.transform(target_T_source, points) - target.points[index]
    along_ours = (gap * se3.rotate(target_T_source, normals)).sum(axis=1)
    along_theirs = (gap * target.normals[index]).sum(axis=1)
    return np.where(near, 0.5 * (np.abs(along_ours) + np.abs(along_theirs)), np.nan)


def _nearest(
    points: Array, normals: Array, target: Cloud, target_T_source: Array, radius: float
) -> tuple[IntArray, BoolArray]:
    """For every point its nearest neighbour, and whether that is near and looks the same way."""
    moved = se3.transform(target_T_source, points)
    distance, index = target.tree.query(moved, distance_upper_bound=radius)
    near = np.isfinite(distance)
    index = np.where(near, index, 0)
    cosine = (se3.rotate(target_T_source, normals) * target.normals[index]).sum(axis=1)
    return index, near & (cosine > SAME_SIDE_COS)


def _steady_normals(scan: CompletedScan) -> Array:
    """(n, 3) normals of the surface, those of its patches where a point is on one."""
    surface = scan.surface
    if not scan.patches:
        return surface.normals
    of_patch = np.stack([patch.normal for patch in scan.patches])[surface.labels]
    alike = (of_patch * surface.normals).sum(axis=1) > SAME_SIDE_COS
    return np.where(((surface.labels >= 0) & alike)[:, None], of_patch, surface.normals)
