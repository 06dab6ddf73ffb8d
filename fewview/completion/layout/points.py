"""The points of one scan as the point networks read them: position, colour, normal.

They are the pixels of the scan's levelled ring, so that a scan gives the same kind of points
whatever its camera, resolution and tilt. Their frame is the wall frame: the level frame turned
about the vertical by at most 45 degrees, so that most upright surfaces run along its axes. A grid
along the walls is far easier to complete than one along the camera's heading.
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
UPRIGHT = 0.9
PHASE_BINS = 36
PHASE_STEPS = 4
PHASE_SHARPNESS = 8.0


@dataclass(frozen=True)
class ScanPoints:
    """A fixed number of a scan's points.

    Attributes:
        points: (n, 3) float32, wall frame, metres.
        colours: (n, 3) float32 RGB in 0..1.
        normals: (n, 3) float32 unit, wall frame, towards the camera; zero where unknown.
        valid: (n,) bool; False in rows that only fill up an empty scan.
        field_of_view: (CELLS, CELLS) bool, cells in a direction that the camera looked in.
        heading: () float32, azimuth of the camera's heading in the wall frame, radians: level
            frame to wall frame is a turn about z by it.
    """

    points: FloatArray
    colours: FloatArray
    normals: FloatArray
    valid: BoolArray
    field_of_view: BoolArray
    heading: FloatArray


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
    points, normal = (a.reshape(-1, 3)[rows] * mask for a in (ring_points(depth), normals))
    heading = np.array(-wall_azimuth(normal), dtype=np.float32)
    turn = about_vertical(heading)
    middle = ring_rays(len(depth))[0, (depth > 0).any(axis=0)]
    return ScanPoints(
        points=np.asarray(points @ turn.T, dtype=np.float32),
        colours=colour.reshape(-1, 3)[rows].astype(np.float32) / np.float32(255.0) * mask,
        normals=np.asarray(normal @ turn.T, dtype=np.float32),
        valid=valid,
        field_of_view=field_of_view(np.arctan2(middle[:, 1], middle[:, 0]) + heading),
        heading=heading,
    )


def wall_azimuth(normals: FloatArray) -> float:
    """The azimuth within 45 degrees of x that upright normals (n, 3) have, modulo 90 degrees.

    A robust mean of four times their azimuths; 0 when there are none.
    """
    flat = np.linalg.norm(normals[:, :2], axis=1)
    upright = flat > UPRIGHT
    turned = np.exp(4j * np.arctan2(normals[upright, 1], normals[upright, 0]))
    counts, edges = np.histogram(np.angle(turned), bins=PHASE_BINS, range=(-np.pi, np.pi))
    smooth = counts + np.roll(counts, 1) + np.roll(counts, -1)
    phase = float(edges[int(smooth.argmax())] + np.pi / PHASE_BINS) if len(turned) else 0.0
    for _ in range(PHASE_STEPS):
        near = np.exp(PHASE_SHARPNESS * (np.real(turned * np.exp(-1j * phase)) - 1.0))
        mean = (near * turned).sum()
        phase = float(np.angle(mean)) if abs(mean) > 0 else phase
    return phase / 4.0


def about_vertical(angle: FloatArray) -> FloatArray:
    """(..., 3, 3) rotations about z by angles (...)."""
    cosine, sine = np.cos(angle), np.sin(angle)
    zero, one = np.zeros_like(cosine), np.ones_like(cosine)
    rows = [[cosine, -sine, zero], [sine, cosine, zero], [zero, zero, one]]
    return np.moveaxis(np.array(rows, dtype=np.float32), (0, 1), (-2, -1))
