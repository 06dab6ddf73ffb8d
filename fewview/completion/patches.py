"""Planar patches of a surface by RANSAC and PCA (Sec. 3.2, third representation)."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from fewview.types import Array, BoolArray, IntArray, PlanarPatch, Surface

SEEDS_PER_ROUND = 48
MAX_ANGLE_COS = np.cos(np.radians(20.0))
MIN_POINTS = 40
CELL_M = 0.20


def find_patches(
    surface: Surface, max_patches: int, rng: np.random.Generator
) -> tuple[Surface, tuple[PlanarPatch, ...]]:
    """Take planar patches off a surface, largest first.

    A hypothesis is one point with its normal; the one that most free points agree with is
    refined by PCA, and its largest connected piece becomes a patch.

    Returns:
        the surface with `labels` filled in, and the patches.
    """
    labels = surface.labels.copy()
    patches: list[PlanarPatch] = []
    tolerance = 0.02 + 0.006 * np.linalg.norm(surface.points, axis=1)
    while len(patches) < max_patches:
        free = np.flatnonzero(labels == -1)
        if len(free) < MIN_POINTS:
            break
        inliers = _best_plane(surface, free, tolerance, rng)
        if len(inliers) < MIN_POINTS:
            break
        members = _largest_piece(surface, inliers)
        if len(members) < MIN_POINTS:
            labels[inliers] = -2
            continue
        labels[members] = len(patches)
        patches.append(_describe(surface, members))
    labels[labels == -2] = -1
    return _ordered_by_size(surface, labels, patches)


def _best_plane(
    surface: Surface, free: IntArray, tolerance: Array, rng: np.random.Generator
) -> IntArray:
    seeds = rng.choice(free, size=min(SEEDS_PER_ROUND, len(free)), replace=False)
    points, normals = surface.points[free], surface.normals[free]
    axes, origins = surface.normals[seeds], surface.points[seeds]
    offset = points @ axes.T - np.einsum("si,si->s", axes, origins)
    agree = (np.abs(offset) < tolerance[free, None]) & (normals @ axes.T > MAX_ANGLE_COS)
    inside = agree[:, int(agree.sum(axis=0).argmax())]
    for _ in range(2):
        inside = _refit(points, normals, inside, tolerance[free])
    return np.asarray(free[inside])


def _refit(points: Array, normals: Array, inside: BoolArray, tolerance: Array) -> BoolArray:
    if inside.sum() < 3:
        return inside
    centre, axes, _ = _principal_axes(points[inside])
    axis = axes[:, 0] * np.sign(normals[inside].mean(axis=0) @ axes[:, 0])
    offset = np.abs((points - centre) @ axis)
    return np.asarray((offset < tolerance) & (normals @ axis > MAX_ANGLE_COS))


def _principal_axes(points: Array) -> tuple[Array, Array, Array]:
    centre = points.mean(axis=0)
    values, axes = np.linalg.eigh(np.cov((points - centre).T))
    return centre, axes, values


def _largest_piece(surface: Surface, members: IntArray) -> IntArray:
    points = surface.points[members]
    centre, axes, _ = _principal_axes(points)
    cells = np.floor((points - centre) @ axes[:, 1:] / CELL_M).astype(int)
    cells -= cells.min(axis=0)
    grid = np.zeros(cells.max(axis=0) + 1, dtype=np.uint8)
    grid[cells[:, 0], cells[:, 1]] = 1
    _, pieces = cv2.connectedComponents(grid, connectivity=8)
    piece = pieces[cells[:, 0], cells[:, 1]]
    return np.asarray(members[piece == np.bincount(piece).argmax()])


def _describe(surface: Surface, members: IntArray) -> PlanarPatch:
    centre, axes, values = _principal_axes(surface.points[members])
    normal = axes[:, 0] * (1.0 if surface.normals[members].mean(axis=0) @ axes[:, 0] > 0 else -1.0)
    extent = np.sqrt(np.maximum(values[[2, 1]], 0.0))
    return PlanarPatch(centre, normal, extent, len(members))


def _ordered_by_size(
    surface: Surface, labels: IntArray, patches: list[PlanarPatch]
) -> tuple[Surface, tuple[PlanarPatch, ...]]:
    order = sorted(range(len(patches)), key=lambda i: -patches[i].count)
    rank = np.full(len(patches) + 1, -1, dtype=np.int64)
    rank[order] = np.arange(len(order))
    return dataclasses.replace(surface, labels=rank[labels]), tuple(patches[i] for i in order)
