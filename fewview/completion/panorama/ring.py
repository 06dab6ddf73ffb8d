"""The levelled ring: four 90-degree pinhole faces around a camera (Sec. 3.2, 360-image).

Level frame: origin at the camera, z up, x along the camera's heading. A ring of size S is an image
(S, 4 S); its faces look, from left to right, to azimuths +90 (left), 0 (front), -90 (right) and
180 degrees (back), counter-clockwise from x seen from above. Depth is planar along a face's axis,
metres, 0 where unknown; it is continuous over the seams.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from fewview.geometry import se3
from fewview.geometry.camera import backproject
from fewview.types import Array, BoolArray, FloatArray, IntArray, Intrinsics, RingScan

FACES = 4
AZIMUTHS = np.radians([90.0, 0.0, -90.0, 180.0])
FORWARD = np.round(np.stack([np.cos(AZIMUTHS), np.sin(AZIMUTHS), 0 * AZIMUTHS], axis=1))
RIGHT = np.round(np.stack([np.sin(AZIMUTHS), -np.cos(AZIMUTHS), 0 * AZIMUTHS], axis=1))
UP = np.array([0.0, 0.0, 1.0])
SAME_SURFACE = 1.05
JUMP = 0.02


def heading_frame(up: Array) -> Array:
    """level_T_scan (4, 4) of a camera whose up direction is ``up`` (3,) in its own axes."""
    up = up / np.linalg.norm(up)
    for axis in (np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])):
        flat = axis - (axis @ up) * up
        if np.linalg.norm(flat) > 0.1:
            break
    heading = flat / np.linalg.norm(flat)
    return se3.pose(np.stack([heading, np.cross(up, heading), up]), np.zeros(3))


@cache
def ring_rays(size: int) -> FloatArray:
    """(S, 4 S, 3) rays in the level frame; depth times ray is the point a pixel shows."""
    steps = (np.arange(size) - (size - 1) / 2) / (size / 2)
    across = FORWARD[:, None] + steps[None, :, None] * RIGHT[:, None]
    rays = across.reshape(1, FACES * size, 3) - steps[:, None, None] * UP
    return np.asarray(rays, dtype=np.float32)


def ring_points(depth: FloatArray) -> FloatArray:
    """(..., S, 4 S) depth to (..., S, 4 S, 3) points in the level frame."""
    return depth[..., None] * ring_rays(depth.shape[-2])


def ring_pixels(points: Array, size: int) -> tuple[IntArray, Array, BoolArray]:
    """Where points of the level frame are seen.

    Args:
        points: (..., 3).
        size: S of the ring.

    Returns:
        flat pixel indices (...) into (S, 4 S), planar depths (...), and which points lie within
        the ring's 45 degrees up and down; the index is 0 for the others.
    """
    forward = points @ FORWARD.T
    face = forward.argmax(axis=-1)
    depth = np.take_along_axis(forward, face[..., None], axis=-1)[..., 0]
    safe = np.maximum(depth, 1e-6)
    u = (size - 1) / 2 + size / 2 * (points * RIGHT[face]).sum(axis=-1) / safe
    v = (size - 1) / 2 - size / 2 * points[..., 2] / safe
    inside = (depth > 1e-6) & (v > -0.5) & (v < size - 0.5)
    column = face * size + np.clip(np.rint(u), 0, size - 1).astype(np.int64)
    row = np.clip(np.rint(v), 0, size - 1).astype(np.int64)
    return np.where(inside, row * FACES * size + column, 0), depth, inside


def project_scan(
    depth: FloatArray,
    colour: NDArray[np.uint8],
    intrinsics: Intrinsics,
    level_T_scan: Array,
    size: int,
) -> RingScan:
    """Turn a scan into its ring; where several pixels meet in one, the nearest surface wins.

    Args:
        depth: (H, W) metres, 0 unknown.
        colour: (H, W, 3) of the same pixels.
        intrinsics: their camera.
        level_T_scan: (4, 4), see `heading_frame`.
        size: S of the ring; the image should be finer than it.
    """
    seen = depth > 0
    points = se3.transform(level_T_scan, backproject(depth, intrinsics)[seen].astype(np.float64))
    pixel, z, inside = ring_pixels(points, size)
    pixel, z, rgb = pixel[inside], z[inside], colour[seen][inside]
    count = FACES * size * size
    nearest = np.full(count, np.inf)
    np.minimum.at(nearest, pixel, z)
    front = z < SAME_SURFACE * nearest[pixel]
    pixel, z, rgb = pixel[front], z[front], rgb[front]
    hits = np.maximum(np.bincount(pixel, minlength=count), 1)
    values = np.stack([np.bincount(pixel, c, count) / hits for c in (z, *rgb.T)], axis=-1)
    image = values.reshape(size, FACES * size, 4)
    ring_colour = np.rint(image[..., 1:]).astype(np.uint8)
    return RingScan(ring_colour, image[..., 0].astype(np.float32), level_T_scan)


def ring_normals(depth: Tensor) -> Tensor:
    """Normals of the surface that a ring's depth shows.

    Differences to the two neighbours of an axis are averaged, a jump in depth counting little.

    Args:
        depth: (B, S, 4 S), 0 unknown.

    Returns:
        (B, 3, S, 4 S) unit normals in the level frame towards the camera, 0 where unknown.
    """
    rays = torch.from_numpy(ring_rays(depth.shape[-2])).to(depth).permute(2, 0, 1)
    stacked = torch.cat([depth[:, None] * rays, depth[:, None]], dim=1)
    right, right_known = _slope(F.pad(stacked, (1, 1, 0, 0), mode="circular"), 3)
    down, down_known = _slope(F.pad(stacked, (0, 0, 1, 1)), 2)
    normal = unit(torch.linalg.cross(right, down, dim=1))
    normal = torch.where((normal * rays).sum(dim=1, keepdim=True) > 0, -normal, normal)
    known = (depth > 0) & right_known & down_known
    return normal * known[:, None]


def unit(vectors: Tensor) -> Tensor:
    """(B, C, ...) vectors along the channels scaled to length one."""
    return vectors * (vectors * vectors).sum(dim=1, keepdim=True).clamp_min(1e-12).rsqrt()


def _slope(padded: Tensor, axis: int) -> tuple[Tensor, Tensor]:
    """Mean difference of points along an axis, and where one exists; padded by one pixel there."""
    length = padded.shape[axis] - 2
    here = padded.narrow(axis, 1, length)
    total = torch.zeros_like(here[:, :3])
    weights = torch.zeros_like(here[:, 3])
    for start, sign in ((0, -1.0), (2, 1.0)):
        there = padded.narrow(axis, start, length)
        both = (there[:, 3] > 0) & (here[:, 3] > 0)
        jump = (there[:, 3] - here[:, 3]) / here[:, 3].clamp_min(1e-3)
        weight = both / (JUMP**2 + jump**2)
        total = total + sign * weight[:, None] * (there[:, :3] - here[:, :3])
        weights = weights + weight
    return total / weights.clamp_min(1e-9)[:, None], weights > 0
