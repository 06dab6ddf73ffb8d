"""The points of one scan as the point networks read them: level frame, colour, normal.

They are the pixels of the scan's levelled ring, so that a scan gives the same kind of points
whatever its camera, resolution and tilt.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from fewview.completion.layout.grid import field_of_view
from fewview.completion.panorama.ring import RingScan, ring_normals, ring_points, ring_rays
from fewview.types import BoolArray, FloatArray, IntArray

POINTS = 2048


@dataclass(frozen=True)
class ScanPoints:
    """A fixed number of a scan's points.

    Attributes:
        points: (n, 3) float32, level frame, metres.
        colours: (n, 3) float32 RGB in 0..1.
        normals: (n, 3) float32 unit, level frame, towards the camera; zero where unknown.
        valid: (n,) bool; False in rows that only fill up an empty scan.
        field_of_view: (CELLS, CELLS) bool, cells in a direction that the camera looked in.
    """

    points: FloatArray
    colours: FloatArray
    normals: FloatArray
    valid: BoolArray
    field_of_view: BoolArray


def scan_points(ring: RingScan, rng: np.random.Generator, count: int = POINTS) -> ScanPoints:
    """Sample ``count`` points of a scan's ring; ``rng`` chooses them."""
    normals = ring_normals(torch.from_numpy(ring.depth)[None])[0].permute(1, 2, 0).numpy()
    pixels = choose_pixels(ring.depth, rng, count)
    return points_of(ring.depth, ring.colour, normals, pixels, count)


def choose_pixels(depth: FloatArray, rng: np.random.Generator, count: int = POINTS) -> IntArray:
    """(at most ``count``,) flat pixels of a ring, drawn without repetition from the measured."""
    return np.asarray(rng.permutation(np.flatnonzero(depth))[:count], dtype=np.int64)


def points_of(
    depth: FloatArray,
    colour: NDArray[np.uint8],
    normals: FloatArray,
    pixels: IntArray,
    count: int = POINTS,
) -> ScanPoints:
    """The points that a ring shows at some pixels, repeated in turn until there are ``count``.

    Args:
        depth: (S, 4 S) measured depth, metres, 0 unknown.
        colour: (S, 4 S, 3).
        normals: (S, 4 S, 3) of the measured depth, level frame, 0 unknown.
        pixels: (m,) flat; none gives rows of zeros that are not valid.
        count: number of rows.
    """
    valid = np.full(count, len(pixels) > 0)
    rows = np.resize(pixels, count) if len(pixels) else np.zeros(count, np.int64)
    mask = valid[:, None].astype(np.float32)
    middle = ring_rays(len(depth))[0, (depth > 0).any(axis=0)]
    return ScanPoints(
        points=ring_points(depth).reshape(-1, 3)[rows] * mask,
        colours=colour.reshape(-1, 3)[rows].astype(np.float32) / np.float32(255.0) * mask,
        normals=normals.reshape(-1, 3)[rows] * mask,
        valid=valid,
        field_of_view=field_of_view(np.arctan2(middle[:, 1], middle[:, 0])),
    )
