"""Rings along the walls.

A ring whose faces look straight at the walls is far easier to complete than one along the camera's
heading: over a wall its depth is constant and its normals are axes. The level frame of such a ring
is turned about the vertical by at most 45 degrees from the heading.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from fewview.completion.panorama.ring import (
    heading_frame,
    project_scan,
    ring_normals,
    ring_pixels,
    ring_rays,
)
from fewview.geometry import se3
from fewview.types import Array, BoolArray, FloatArray, IntArray, Intrinsics, RingScan

MIN_PIXELS = 30
MIN_SHARE = 0.4
UPRIGHT = 0.95
SAMPLES = 4


def scan_ring(
    depth: FloatArray,
    colour: NDArray[np.uint8],
    intrinsics: Intrinsics,
    up: Array,
    size: int = 64,
) -> RingScan:
    """The ring of a scan along the walls that it shows, or along its heading if it shows none.

    Of a fine image every few pixels are used, so many that a ring's pixel still averages over
    about `SAMPLES` of them a side.

    Args:
        depth: (H, W) metres, 0 unknown.
        colour: (H, W, 3) of the same pixels.
        intrinsics: their camera.
        up: (3,) upward direction in the scan's frame.
        size: S of the ring.
    """
    step = max(1, int(intrinsics.fx / (SAMPLES * size / 2)))
    depth, colour, intrinsics = (
        depth[::step, ::step],
        colour[::step, ::step],
        _thinned(intrinsics, step),
    )
    level_T_scan = heading_frame(up)
    ahead = project_scan(depth, colour, intrinsics, level_T_scan, size)
    turned = about_vertical(-wall_azimuth(seen_normals(ahead.depth))) @ level_T_scan
    return project_scan(depth, colour, intrinsics, turned, size)


def _thinned(camera: Intrinsics, step: int) -> Intrinsics:
    """The camera of an image of which every ``step``-th row and column are kept."""
    width, height = -(-camera.width // step), -(-camera.height // step)
    return Intrinsics(
        width, height, camera.fx / step, camera.fy / step, camera.cx / step, camera.cy / step
    )


def wall_azimuth(normals: FloatArray) -> float:
    """The azimuth within 45 degrees of x that upright normals have modulo 90 degrees.

    The circular mean of four times their azimuths, taken over all and then twice over those
    within 15 degrees of the last; 0 when few are upright or few of those agree.

    Args:
        normals: (..., 3), 0 unknown.
    """
    x, y = normals[..., 0].ravel(), normals[..., 1].ravel()
    upright = x * x + y * y > UPRIGHT**2
    turns = np.exp(4j * np.arctan2(y[upright], x[upright]))
    if len(turns) < MIN_PIXELS:
        return 0.0
    near = np.ones(len(turns), bool)
    for _ in range(3):
        mean = (turns * near).sum()
        near = (turns * np.conj(mean)).real > 0.5 * abs(mean)
    return float(np.angle(mean)) / 4.0 if near.mean() > MIN_SHARE else 0.0


def seen_normals(depth: FloatArray) -> FloatArray:
    """`ring_normals` (S, 4 S, 3) of one ring's depth (S, 4 S)."""
    normals = ring_normals(torch.from_numpy(depth)[None])[0]
    return np.asarray(normals.permute(1, 2, 0).numpy(), dtype=np.float32)


def turned_pixels(size: int, azimuth: float) -> tuple[IntArray, FloatArray, BoolArray]:
    """Where a ring whose x axis has an azimuth in the old ring finds its pixels there.

    Returns:
        flat pixels (S, 4 S) of the old ring, what its depths are to be multiplied by, and which
        pixels it shows: near the upper and lower edge the two do not cover the same directions.
    """
    rays = ring_rays(size) @ about_vertical(azimuth)[:3, :3].T
    pixels, depth, inside = ring_pixels(rays, size)
    return pixels, (1.0 / np.maximum(depth, 1e-6)).astype(np.float32), inside


def about_vertical(angle: float) -> Array:
    """The turn (4, 4) about the z axis."""
    return se3.pose(se3.rotation_exp(np.array([0.0, 0.0, angle])), np.zeros(3))
