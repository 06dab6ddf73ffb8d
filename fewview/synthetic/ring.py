"""The ring: four square faces of 90 degrees side by side, left, front, right and back.

Level frame of a camera: origin at the camera, z up, x along its heading. Face centres lie at
azimuths 90, 0, -90 and 180 degrees, counter-clockwise from x seen from above; x of the image grows
to the right, where the azimuth falls.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from fewview.geometry import se3
from fewview.types import Array, BoolArray, FloatArray

AZIMUTHS = (0.5 * np.pi, 0.0, -0.5 * np.pi, np.pi)
"""Of the faces' centres, from left to right."""


@cache
def rays(size: int) -> FloatArray:
    """(size, 4 size, 3) directions in the level frame, of length 1 along their face's axis."""
    across = (np.arange(size) - 0.5 * (size - 1)) / (0.5 * size)
    faces = []
    for azimuth in AZIMUTHS:
        ahead = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
        down = np.array([0.0, 0.0, -1.0])
        faces.append(ahead + across[None, :, None] * right + across[:, None, None] * down)
    out = np.concatenate(faces, axis=1).astype(np.float32)
    out.setflags(write=False)
    return out


def beams(level_T_world: Array, size: int) -> FloatArray:
    """(V size 4 size, 6) origins and directions in the world of the rings of V cameras."""
    world_T_level = se3.inverse(level_T_world).astype(np.float32)
    out = np.empty((len(level_T_world), 4 * size * size, 6), np.float32)
    out[..., :3] = world_T_level[:, None, :3, 3]
    turned = world_T_level[:, :3, :3].swapaxes(1, 2)
    np.matmul(rays(size).reshape(1, -1, 3), turned, out=out[..., 3:])
    return out.reshape(-1, 6)


def points(depth: FloatArray) -> FloatArray:
    """(..., S, 4 S) depth along the faces' axes to (..., S, 4 S, 3) points in the level frame."""
    return depth[..., None] * rays(depth.shape[-2])


def seen_by(
    scan_R_level: Array, half_angles: tuple[float, float], size: int
) -> tuple[BoolArray, FloatArray]:
    """Where a camera at the ring's centre looks.

    Args:
        scan_R_level: (3, 3) axes of the camera.
        half_angles: half its horizontal and vertical field of view, radians.
        size: of a face, pixels.

    Returns:
        (size, 4 size) inside its field of view, and the depth along the camera's axis of a point
        whose depth along the face's axis is one.
    """
    local = rays(size) @ scan_R_level.T.astype(np.float32)
    limit = np.tan(half_angles).astype(np.float32)
    ahead = local[..., 2]
    inside = (ahead > 0) & (np.abs(local[..., :2]) < limit * ahead[..., None]).all(axis=-1)
    return inside, ahead


def sight(depth: FloatArray, points: Array) -> Array:
    """How far one sees, over or past everything, towards points.

    Args:
        depth: (S, 4 S) of a ring.
        points: (n, 2 or 3) in the level frame.

    Returns:
        (n,) horizontal distances, metres.
    """
    size = depth.shape[0]
    reach = depth.max(axis=0) * np.hypot(*rays(size)[0, :, :2].T)
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    turned = 0.75 * np.pi - azimuth
    face = np.floor(turned / (0.5 * np.pi)).astype(int) % 4
    inner = np.tan(np.mod(turned, 0.5 * np.pi) - 0.25 * np.pi)
    column = np.rint(0.5 * size * inner + 0.5 * (size - 1)).astype(int).clip(0, size - 1)
    return np.asarray(reach[face * size + column], np.float64)
