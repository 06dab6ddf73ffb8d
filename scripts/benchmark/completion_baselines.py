"""What completion is compared with: typical rooms, a box around what was seen, nearest rooms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.completion_views import SIZE, GeneratedRoom, Truth, View
from fewview.completion.layout.grid import CLASSES as GROUND_CLASSES
from fewview.completion.layout.grid import FREE, UNKNOWN, WALL, cell_centres
from fewview.completion.panorama.network import CLASSES
from fewview.completion.panorama.ring import ring_rays
from fewview.completion.patches import find_patches
from fewview.training.point_batches import CEILING, FLOOR
from fewview.training.point_batches import WALL as WALL_PLANE
from fewview.types import Array, BoolArray, FloatArray, IntArray, Surface

Bytes = NDArray[np.uint8]
DIRECTIONS = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, -1], [0, 0, 1]])
"""Of a box: ahead, left, behind, right, floor, ceiling."""
KINDS = np.array([WALL_PLANE] * 4 + [FLOOR, CEILING], np.uint8)
FACES = (1, 0, 3, 2)
"""Number of the ring's face that looks ahead, left, behind, right."""
SURFACES = np.array([CLASSES.index(n) for n in ("wall",) * 4 + ("floor", "ceiling")], np.uint8)
TRIM = 0.98
MIN_FACING, FACING_COS = 50, 0.9
"""A side of the box is seen when so many points face away from it."""
WALL_THICK_M = 0.15
PATCHES = 12
UPRIGHT, FLAT, LOW_M = 0.3, 0.9, -0.5


@dataclass(frozen=True)
class RingAnswer:
    """A completed ring: depth (S, 4 S), normals (S, 4 S, 3), classes (S, 4 S), and, from methods
    that tell it, the probability that the depth is right within ten per cent."""

    depth: FloatArray
    normals: FloatArray
    semantics: Bytes
    confidence: FloatArray | None = None


@dataclass(frozen=True)
class Typical:
    """What training rooms look like from their cameras.

    Attributes:
        ring: median depth, mean normal and most frequent class of each pixel.
        reach: (6,) median distance of a room's sides along `DIRECTIONS`, metres.
        grounds: (N, G, G) layouts.
    """

    ring: RingAnswer
    reach: Array
    grounds: Bytes

    @property
    def ground(self) -> Bytes:
        """(G, G) most frequent class of each cell."""
        counts = [(self.grounds == c).sum(axis=0) for c in range(len(GROUND_CLASSES))]
        return np.asarray(np.argmax(counts, axis=0), np.uint8)

    def nearest(self, seen_ground: Bytes, seen: BoolArray) -> Bytes:
        """(G, G) the layout that agrees in most of the cells that were seen.

        Args:
            seen_ground: (G, G) classes, looked at where (G, G) ``seen``: a scan is told them.
            seen: cells that it sees.
        """
        agree = (self.grounds[:, seen] == seen_ground[seen]).sum(axis=1)
        return np.asarray(self.grounds[int(agree.argmax())], np.uint8)


def typical(rooms: Sequence[GeneratedRoom]) -> Typical:
    """Look at rooms of the training split."""
    depths, grounds, heights = [], [], []
    normals = np.zeros((SIZE, 4 * SIZE, 3))
    votes = np.zeros((len(CLASSES), SIZE, 4 * SIZE), np.int64)
    for room in rooms:
        for view in room.views():
            truth = view.truth
            depths.append(np.where(truth.depth > 0, truth.depth, np.nan).astype(np.float16))
            grounds.append(truth.ground)
            heights.append(_levels(truth))
            normals += truth.normals
            votes += np.arange(len(CLASSES))[:, None, None] == truth.semantics
    every = np.stack(depths).astype(np.float32)
    every[0, np.isnan(every).all(axis=0)] = np.nanmedian(every)
    depth = np.nanmedian(every, axis=0)
    unit = normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-9)
    classes = votes[1:].argmax(axis=0).astype(np.uint8) + np.uint8(1)
    middles = SIZE // 2 + SIZE * np.array(FACES)
    return Typical(
        RingAnswer(depth, unit.astype(np.float32), classes),
        np.concatenate([depth[SIZE // 2, middles], np.nanmedian(heights, axis=0)]),
        np.stack(grounds),
    )


def box_around(view: View, reach: Array) -> Array:
    """Six planes (6, 4), normals inwards, of the box along the ring around what was seen.

    Args:
        view: the scan.
        reach: (6,) how far a side is at least that is not seen itself; see `Typical`.
    """
    points, normals = level_points(view)
    along = points @ DIRECTIONS.T
    extent = np.quantile(along, TRIM, axis=0) if len(points) else np.zeros(len(DIRECTIONS))
    seen = (normals @ DIRECTIONS.T < -FACING_COS).sum(axis=0) > MIN_FACING
    seen[4] &= extent[4] > -LOW_M
    seen[5] &= extent[5] > 0.0
    distance = np.where(seen, np.maximum(extent, 0.1), np.maximum(extent, reach))
    return np.column_stack([-DIRECTIONS, -distance])


def box_ring(box: Array) -> RingAnswer:
    """The ring of an empty box."""
    facing = ring_rays(SIZE) @ box[:, :3].T
    depth = np.where(facing < 0, box[:, 3] / np.minimum(facing, -1e-9), np.inf)
    hit = depth.argmin(axis=-1)
    nearest = np.take_along_axis(depth, hit[..., None], axis=-1)[..., 0]
    return RingAnswer(nearest.astype(np.float32), box[hit, :3].astype(np.float32), SURFACES[hit])


def box_ground(box: Array, view: View) -> Bytes:
    """(G, G) the layout of an empty box."""
    centres = cell_centres().astype(np.float64) @ view.points.wall_R_level[:2, :2]
    beyond = (box[:4, 3] - centres @ box[:4, :2].T).max(axis=-1)
    out = np.where(beyond < 0, FREE, np.where(beyond < WALL_THICK_M, WALL, UNKNOWN))
    return out.astype(np.uint8)


def seen_patches(view: View) -> tuple[Array, Bytes]:
    """Planes (P, 4) of the planar patches of what was seen that look structural, and kinds (P,).

    All upright ones count as walls, the lowest that faces up as the floor, the highest that faces
    down as the ceiling.
    """
    points, normals = level_points(view)
    blank = np.zeros(points.shape, np.float32), np.full(len(points), -1, np.int64)
    rng = np.random.default_rng(0)
    _, patches = find_patches(Surface(points, normals, *blank), PATCHES, rng)
    planes = np.array([np.append(p.normal, p.normal @ p.centre) for p in patches]).reshape(-1, 4)
    up, height = planes[:, 2], planes[:, 2] * planes[:, 3]
    kinds = np.where(np.abs(up) < UPRIGHT, WALL_PLANE, 0)
    for kind, faces, order in ((FLOOR, up > FLAT, height), (CEILING, up < -FLAT, -height)):
        low = np.where(faces & ((kind == CEILING) | (height < LOW_M)), order, np.inf)
        if np.isfinite(low).any():
            kinds[int(low.argmin())] = kind
    return planes[kinds > 0], kinds[kinds > 0].astype(np.uint8)


def level_points(view: View) -> tuple[Array, Array]:
    """The scan's points and normals (n, 3) in the level frame of its ring, where both are known."""
    scan = view.points
    known = scan.valid & (np.linalg.norm(scan.normals, axis=1) > 0.5)
    turn = scan.wall_R_level.astype(np.float64)
    return scan.points[known] @ turn, scan.normals[known] @ turn


def _levels(truth: Truth) -> tuple[float, float]:
    """Distances of floor and ceiling, NaN where there is none."""
    flat = np.abs(truth.planes[:, 2]) > 0.99
    found: list[float] = []
    for kind in (FLOOR, CEILING):
        mine: IntArray = np.flatnonzero(flat & (truth.kinds == kind))
        found.append(float(-truth.planes[mine, 3].min()) if len(mine) else np.nan)
    return found[0], found[1]
