"""Pinhole projection, back-projection and normals of depth images."""

from __future__ import annotations

import numpy as np

from fewview.types import Array, BoolArray, FloatArray, Intrinsics


def backproject(depth: FloatArray, intrinsics: Intrinsics) -> FloatArray:
    """(H, W) depth in metres to an (H, W, 3) map of points in the camera frame."""
    v, u = np.indices(depth.shape, dtype=np.float32)
    x = (u - np.float32(intrinsics.cx)) * depth / np.float32(intrinsics.fx)
    y = (v - np.float32(intrinsics.cy)) * depth / np.float32(intrinsics.fy)
    return np.stack([x, y, depth], axis=-1)


def lift(pixels: FloatArray, depth: FloatArray, intrinsics: Intrinsics) -> Array:
    """Points (n, 3) in the camera frame of pixels (n, 2) with depths (n,)."""
    z = depth.astype(np.float64)
    x = (pixels[:, 0] - intrinsics.cx) * z / intrinsics.fx
    y = (pixels[:, 1] - intrinsics.cy) * z / intrinsics.fy
    return np.stack([x, y, z], axis=-1)


def project(points: Array, intrinsics: Intrinsics) -> tuple[Array, BoolArray]:
    """Pixels (..., 2) of points (..., 3), and which of them fall inside the image."""
    z = points[..., 2]
    front = z > 1e-3
    safe = np.where(front, z, 1.0)
    u = points[..., 0] * intrinsics.fx / safe + intrinsics.cx
    v = points[..., 1] * intrinsics.fy / safe + intrinsics.cy
    inside = front & (u > -0.5) & (v > -0.5)
    inside &= (u < intrinsics.width - 0.5) & (v < intrinsics.height - 0.5)
    return np.stack([u, v], axis=-1), inside


def depth_edges(depth: FloatArray, relative: float = 0.05) -> BoolArray:
    """Pixels beside a jump in depth larger than ``relative`` of their own depth."""
    edge = np.zeros(depth.shape, dtype=bool)
    for axis in (0, 1):
        step = np.abs(np.diff(depth, axis=axis))
        low = [slice(None), slice(None)]
        high = [slice(None), slice(None)]
        low[axis], high[axis] = slice(None, -1), slice(1, None)
        near = np.minimum(depth[tuple(low)], depth[tuple(high)])
        jump = (step > relative * near) & (near > 0)
        edge[tuple(low)] |= jump
        edge[tuple(high)] |= jump
    return edge
