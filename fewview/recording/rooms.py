"""What completion adds around a scan, in space: predicted points and structural planes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fewview.completion.panorama import CLASSES, ring_points
from fewview.geometry import se3
from fewview.types import (
    Array,
    BoolArray,
    CompletedPanorama,
    CompletedRoom,
    FloatArray,
    StructuralPlane,
)

_COLOURS = {
    "unknown": (48, 50, 56),
    "wall": (160, 180, 205),
    "floor": (125, 200, 130),
    "ceiling": (232, 226, 208),
    "door": (205, 60, 60),
    "window": (80, 185, 240),
    "table": (240, 145, 50),
    "chair": (190, 190, 50),
    "sofa": (150, 105, 190),
    "bed": (225, 125, 190),
    "cabinet": (140, 90, 75),
    "other": (250, 220, 100),
}
CLASS_COLOURS = np.array([_COLOURS[name] for name in CLASSES], dtype=np.uint8)
"""(12, 3) RGB of the classes of the 360-image."""
STRIDE = 2
MIN_HALF_M, MAX_HALF_M = 0.3, 3.0
CROSSING = 0.7
"""Sine of the smallest angle between a wall and another one that ends it."""


@dataclass(frozen=True)
class RoomShape:
    """The completed room of one scan in the scan's frame, metres.

    Attributes:
        points: (n, 3) float32, what the completed 360-image predicts but for the ceiling, which
            would hide the rest, every `STRIDE`-th pixel.
        point_colours: (n, 3) uint8 RGB of their classes.
        rectangles: (m, 4, 3), one for each structural plane; see `rectangles`.
        kinds: of the planes; see `StructuralPlane`.
        observed: (m,) bool, whether the scan shows part of the plane.
        height: from floor to ceiling, metres, None without planes.
    """

    points: FloatArray
    point_colours: NDArray[np.uint8]
    rectangles: Array
    kinds: tuple[str, ...]
    observed: BoolArray
    height: float | None

    @property
    def vertices(self) -> Array:
        """(k, 3) the points and the corners."""
        return np.concatenate([self.points, self.rectangles.reshape(-1, 3)])

    def walls(self, observed: bool) -> int:
        """How many walls the scan shows, or how many are predicted."""
        pairs = zip(self.kinds, self.observed, strict=True)
        return sum(kind == "wall" and seen == observed for kind, seen in pairs)


def room_shape(room: CompletedRoom) -> RoomShape:
    """What a completed room looks like in space; empty where a network was not asked."""
    scan_T_level = se3.inverse(room.level_T_scan)
    points, colours = np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
    if room.panorama is not None:
        points, colours = _predicted(room.panorama)
    planes = () if room.planes is None else room.planes.planes
    corners = rectangles(planes)
    heights = {p.kind: float(p.centre[2]) for p in planes}
    return RoomShape(
        se3.transform(scan_T_level, points).astype(np.float32),
        colours,
        se3.transform(scan_T_level, corners.reshape(-1, 3)).reshape(corners.shape),
        tuple(p.kind for p in planes),
        np.array([p.observed for p in planes], dtype=bool),
        heights["ceiling"] - heights["floor"] if planes else None,
    )


def rectangles(planes: Sequence[StructuralPlane]) -> Array:
    """(m, 4, 3) corners of structural planes, counter-clockwise seen from the room, level frame.

    A wall reaches from the floor to the ceiling and, from its centre, as far as the nearest other
    wall that crosses it, on both sides; floor and ceiling lie along the first wall and hold the
    ends of all walls.
    """
    if not planes:
        return np.zeros((0, 4, 3))
    centres = np.stack([p.centre for p in planes])
    normals = np.stack([p.normal for p in planes])
    kinds = np.array([p.kind for p in planes])
    wall = kinds == "wall"
    ends = _wall_ends(centres[wall, :2], normals[wall, :2])
    around = np.concatenate([ends.reshape(-1, 2), centres[~wall, :2]])
    area = _area(around, normals[wall, :2][0] if wall.any() else np.array([1.0, 0.0]))
    low, high = centres[kinds == "floor", 2], centres[kinds == "ceiling", 2]
    out = np.empty((len(planes), 4, 3))
    out[kinds == "floor", :, :2] = area
    out[kinds == "ceiling", :, :2] = area[::-1]
    out[~wall, :, 2] = centres[~wall, 2, None]
    out[wall, :, :2] = ends[:, [0, 1, 1, 0]]
    out[wall, :, 2] = np.concatenate([low, low, high, high])
    return out


def _wall_ends(centres: Array, normals: Array) -> Array:
    """(w, 2, 2) the two ends of walls seen from above, given centres and normals (w, 2)."""
    along = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
    crossing = along @ normals.T
    gap = np.einsum("ijk,jk->ij", centres[None] - centres[:, None], normals)
    crosses = np.abs(crossing) > CROSSING
    reach = np.where(crosses, np.abs(gap / np.where(crosses, crossing, 1.0)), MAX_HALF_M)
    half = np.clip(reach.min(axis=1, initial=MAX_HALF_M), MIN_HALF_M, MAX_HALF_M)
    step = half[:, None] * along
    return np.stack([centres - step, centres + step], axis=1)


def _area(points: Array, along: Array) -> Array:
    """(4, 2) the rectangle around points (n, 2) with a side ``along`` (2,), counter-clockwise."""
    axes = np.stack([along, [-along[1], along[0]]])
    (x0, y0), (x1, y1) = np.quantile(points @ axes.T, [0.0, 1.0], axis=0)
    corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    return np.asarray(corners @ axes)


def _predicted(panorama: CompletedPanorama) -> tuple[Array, NDArray[np.uint8]]:
    """Points (n, 3) in the level frame and colours (n, 3) where nothing was measured."""
    classes = panorama.semantics.argmax(axis=-1)
    some = ~panorama.observed & (classes != CLASSES.index("ceiling"))
    some[np.arange(len(some)) % STRIDE > 0] = False
    some[:, np.arange(some.shape[1]) % STRIDE > 0] = False
    points = ring_points(panorama.depth)[some].astype(np.float64)
    return points, CLASS_COLOURS[classes[some]]
