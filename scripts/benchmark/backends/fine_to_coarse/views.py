"""What one frame gives to Fine-to-Coarse: points with normals, and its planes (base proxies)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from fewview.completion.local_geometry import DepthView, thin_surface
from fewview.completion.patches import find_patches
from fewview.geometry.camera import project
from fewview.types import Array, BoolArray, Frame, IntArray, Surface

MAX_DEPTH_M = 5.0
"""`max_depth` of the authors' program."""
VOXEL_M = 0.05
MAX_PLANES = 16
QUERIES = 256
"""Points of a frame that ask another frame for their closest point; `n_samples` likewise."""
POINTS_PER_PLANE = 32
INNER_SHARE = 0.9
"""Points with less of their window measured lie on a boundary."""


@dataclass(frozen=True)
class View:
    """A frame's geometry in its own frame.

    Attributes:
        points: (n, 3) metres, one a voxel.
        normals: (n, 3) unit, towards the camera.
        inner: (n,) False on image borders, beside holes and at depth edges.
        queries: (q,) indices of inner points, at most `QUERIES`.
        tree: k-d tree of the points.
        planes: (p, 3) unit normals of the planes, towards the camera.
        members: (p, POINTS_PER_PLANE, 3) points on each plane.
        counts: (p,) how many points each plane has.
        radius: half the diagonal of the points' bounding box, metres; 1 without inner
            points.
    """

    points: Array
    normals: Array
    inner: BoolArray
    queries: IntArray
    tree: cKDTree
    planes: Array
    members: Array
    counts: IntArray
    radius: float


def view_of(frame: Frame) -> View:
    """Thin a frame's depth and find its planes."""
    rng = np.random.default_rng(0)
    view = DepthView.of(frame, MAX_DEPTH_M)
    surface, patches = find_patches(thin_surface(view, frame.colour, VOXEL_M), MAX_PLANES, rng)
    inner = _inner(view, surface.points)
    found = np.flatnonzero(inner)
    return View(
        surface.points,
        surface.normals,
        inner,
        rng.choice(found, min(QUERIES, len(found)), replace=False),
        cKDTree(surface.points),
        np.array([patch.normal for patch in patches]).reshape(-1, 3),
        _members(surface, len(patches), rng),
        np.array([patch.count for patch in patches], dtype=np.int64),
        0.5 * float(np.linalg.norm(np.ptp(surface.points, axis=0))) if len(found) else 1.0,
    )


def _inner(view: DepthView, points: Array) -> BoolArray:
    pixels, _ = project(points, view.intrinsics)
    columns, rows = pixels.round().astype(np.int64).T
    rows = rows.clip(0, view.depth.shape[0] - 1)
    columns = columns.clip(0, view.depth.shape[1] - 1)
    return np.asarray(view.moments[rows, columns, 0] > INNER_SHARE)


def _members(surface: Surface, planes: int, rng: np.random.Generator) -> Array:
    chosen = [
        rng.choice(np.flatnonzero(surface.labels == plane), POINTS_PER_PLANE)
        for plane in range(planes)
    ]
    indices = np.array(chosen, dtype=np.int64).reshape(planes, POINTS_PER_PLANE)
    return surface.points[indices]
