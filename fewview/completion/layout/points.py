"""The points of one scan as the point networks read them: position, colour, normal.

They are the pixels of the scan's levelled ring, so that a scan gives the same kind of points
whatever its camera, resolution and tilt. Their frame is the wall frame: z up, most upright surfaces
along its axes, x within 45 degrees of the camera's heading. A grid along the walls is far easier to
complete than one along the heading.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fewview.completion.layout.grid import field_of_view
from fewview.completion.panorama.ring import ring_points, ring_rays
from fewview.completion.panorama.walls import seen_normals, wall_azimuth
from fewview.geometry import se3
from fewview.types import Array, BoolArray, FloatArray, IntArray, RingScan

POINTS = 2048
QUARTER = 0.5 * np.pi


@dataclass(frozen=True)
class ScanPoints:
    """A fixed number of a scan's points.

    Attributes:
        points: (n, 3) float32, wall frame, metres.
        colours: (n, 3) float32 RGB in 0..1.
        normals: (n, 3) float32 unit, wall frame, towards the camera; zero where unknown.
        valid: (n,) bool; False in rows that only fill up an empty scan.
        pixels: (n,) flat pixel of the ring that each point is.
        field_of_view: (CELLS, CELLS) bool, cells in a direction that the camera looked in.
        heading: () float32, azimuth of the camera's heading in the wall frame, radians.
        wall_R_level: (3, 3) float32 from the level frame of the ring to the wall frame.
        ring_colour: (S, 4 S, 3), ring_depth: (S, 4 S) metres: the ring.
    """

    points: FloatArray
    colours: FloatArray
    normals: FloatArray
    valid: BoolArray
    pixels: IntArray
    field_of_view: BoolArray
    heading: FloatArray
    wall_R_level: FloatArray
    ring_colour: NDArray[np.uint8]
    ring_depth: FloatArray


def scan_points(ring: RingScan, rng: np.random.Generator, count: int = POINTS) -> ScanPoints:
    """Sample ``count`` points of a scan's ring; ``rng`` chooses them."""
    pixels = choose_pixels(ring.depth, rng, count)
    ahead = ring.level_T_scan[:2, 2]
    heading = float(np.arctan2(ahead[1], ahead[0]))
    return points_of(ring.depth, ring.colour, seen_normals(ring.depth), pixels, count, heading)


def choose_pixels(depth: FloatArray, rng: np.random.Generator, count: int = POINTS) -> IntArray:
    """(at most ``count``,) flat pixels of a ring, drawn without repetition from the measured."""
    return np.asarray(rng.permutation(np.flatnonzero(depth))[:count], dtype=np.int64)


def points_of(
    depth: FloatArray,
    colour: NDArray[np.uint8],
    normals: FloatArray,
    pixels: IntArray,
    count: int = POINTS,
    heading: float = 0.0,
) -> ScanPoints:
    """The points that a ring shows at some pixels, repeated in turn until there are ``count``.

    Args:
        depth: (S, 4 S) measured depth, metres, 0 unknown.
        colour: (S, 4 S, 3).
        normals: (S, 4 S, 3) of the measured depth, level frame, 0 unknown.
        pixels: (m,) flat; none gives rows of zeros that are not valid.
        count: number of rows.
        heading: azimuth of the camera's heading in the ring's level frame.
    """
    valid = np.full(count, len(pixels) > 0)
    rows = np.resize(pixels, count) if len(pixels) else np.zeros(count, np.int64)
    mask = valid[:, None].astype(np.float32)
    points, normal = (a.reshape(-1, 3)[rows] * mask for a in (ring_points(depth), normals))
    turn = -wall_azimuth(normal)
    turn -= QUARTER * round((heading + turn) / QUARTER)
    wall_R_level = about_vertical(np.array(turn))
    middle = ring_rays(len(depth))[0, (depth > 0).any(axis=0)]
    azimuths = np.arctan2(middle[:, 1], middle[:, 0]) + np.float32(turn)
    return ScanPoints(
        points=np.asarray(points @ wall_R_level.T, dtype=np.float32),
        colours=colour.reshape(-1, 3)[rows].astype(np.float32) / np.float32(255.0) * mask,
        normals=np.asarray(normal @ wall_R_level.T, dtype=np.float32),
        valid=valid,
        pixels=rows,
        field_of_view=field_of_view(azimuths),
        heading=np.array(heading + turn, dtype=np.float32),
        wall_R_level=wall_R_level,
        ring_colour=colour,
        ring_depth=depth,
    )


def about_vertical(angle: Array) -> FloatArray:
    """(..., 3, 3) rotations about z by angles (...)."""
    return se3.rotation_exp(angle[..., None] * np.array([0.0, 0.0, 1.0])).astype(np.float32)
