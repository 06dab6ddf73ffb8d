"""What speaks for and against a refined pose: agreement, contradiction, gravity, free space."""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from fewview.geometry import se3
from fewview.geometry.camera import project
from fewview.types import Array, CompletedScan, FloatArray, Levelling, Surface

NEAR_M = 0.08
MAX_POINTS = 1200
VISIBLE_TOLERANCE_M = 0.05
VISIBLE_TOLERANCE_RELATIVE = 0.02


def visible_agreement(
    scan: CompletedScan, points: Array, depth_min: FloatArray, depth_max: FloatArray
) -> tuple[Array, Array, Array]:
    """How points fare against the depth image of a scan that should see them.

    Args:
        scan: the scan that looks.
        points: (K, n, 3) in its frame.
        depth_min, depth_max: (h, w) smallest and largest depth around each pixel, 0 unknown.

    Returns:
        (K,) number of points that fall on measured pixels, the share of these on the measured
        surface, and the share that lies in front of it, in space the scan has seen to be free.
    """
    pixels, inside = project(points, scan.intrinsics)
    columns = np.where(inside, np.rint(pixels[..., 0]), 0).astype(int)
    rows = np.where(inside, np.rint(pixels[..., 1]), 0).astype(int)
    near, far, z = depth_min[rows, columns], depth_max[rows, columns], points[..., 2]
    measured = inside & (near > 0)
    tolerance = VISIBLE_TOLERANCE_M + VISIBLE_TOLERANCE_RELATIVE * z
    in_front = measured & (z < near - tolerance)
    on_surface = measured & ~in_front & (z < far + tolerance)
    count = measured.sum(axis=-1)
    total = np.maximum(count, 1)
    return count, on_surface.sum(axis=-1) / total, in_front.sum(axis=-1) / total


def depth_bounds(depth: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Smallest and largest valid depth in 3 x 3 pixels, 0 where none is valid."""
    low = ndimage.minimum_filter(np.where(depth > 0, depth, np.inf), size=3)
    high = ndimage.maximum_filter(depth, size=3)
    return np.where(np.isfinite(low), low, 0).astype(np.float32), high


def surface_agreement(
    source: Surface,
    target: Surface,
    trees: tuple[cKDTree, cKDTree],
    target_T_source: Array,
) -> tuple[Array, Array]:
    """Overlap and residual of (K, 4, 4) poses.

    Returns:
        (K,) share of the smaller surface that has a neighbour within 0.08 m facing the same way,
        and (K,) mean point-to-plane distance of these, metres.
    """
    forward = _near(source, target, trees[1], target_T_source)
    backward = _near(target, source, trees[0], se3.inverse(target_T_source))
    smaller, other = (forward, backward)
    if len(target.points) < len(source.points):
        smaller, other = backward, forward
    count = np.maximum(smaller[1] + other[1], 1)
    residual = (smaller[2] + other[2]) / count
    return smaller[0], np.where(smaller[1] + other[1] > 0, residual, NEAR_M)


def _near(
    moving: Surface, fixed: Surface, tree: cKDTree, fixed_T_moving: Array
) -> tuple[Array, Array, Array]:
    step = max(1, len(moving.points) // MAX_POINTS)
    points = se3.transform(fixed_T_moving, moving.points[::step])
    normals = se3.rotate(fixed_T_moving, moving.normals[::step])
    distance, index = tree.query(points.reshape(-1, 3), distance_upper_bound=NEAR_M)
    found = np.isfinite(distance).reshape(points.shape[:2])
    index = np.where(np.isfinite(distance), index, 0).reshape(points.shape[:2])
    facing = (normals * fixed.normals[index]).sum(axis=-1) > 0.7
    found &= facing
    gap = np.abs(((points - fixed.points[index]) * fixed.normals[index]).sum(axis=-1))
    count = found.sum(axis=-1)
    return count / max(points.shape[1], 1), count, (gap * found).sum(axis=-1)


def gravity_disagreement(
    source: Levelling, target: Levelling, target_T_source: Array
) -> tuple[Array, Array]:
    """(K,) angle between the two scans' up directions under the poses, radians, and (K,) distance
    between their floors, metres, 0 where a floor is unknown."""
    turned = target_T_source[:, :3, :3] @ source.level_R_scan[2]
    tilt = np.arccos(np.clip(turned @ target.level_R_scan[2], -1.0, 1.0))
    if source.floor_z is None or target.floor_z is None:
        return tilt, np.zeros(len(tilt))
    lift = target_T_source[:, :3, 3] @ target.level_R_scan[2]
    return tilt, np.abs(source.floor_z + lift - target.floor_z)


def yaw_disagreement(source: Levelling, target: Levelling, target_T_source: Array) -> Array:
    """(K,) angle between the Manhattan frames modulo 90 degrees, 0 where one is unknown."""
    if not (source.manhattan and target.manhattan):
        return np.zeros(len(target_T_source))
    turned = target_T_source[:, :3, :3] @ source.level_R_scan[0]
    level = turned @ target.level_R_scan.T
    angle = np.arctan2(level[:, 1], level[:, 0])
    return np.abs((angle + np.pi / 4) % (np.pi / 2) - np.pi / 4)
