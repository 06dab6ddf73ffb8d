"""Rigid motions as 4x4 arrays; every function takes leading batch dimensions.

Tangent vectors are (rotation, translation), the order of GTSAM's Pose3.
"""

from __future__ import annotations

import numpy as np

from fewview.types import Array


def hat(v: Array) -> Array:
    """(..., 3) vectors to (..., 3, 3) cross-product matrices."""
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def pose(rotation: Array, translation: Array) -> Array:
    """(..., 3, 3) and (..., 3) to (..., 4, 4)."""
    out = np.zeros((*rotation.shape[:-2], 4, 4))
    out[..., :3, :3] = rotation
    out[..., :3, 3] = translation
    out[..., 3, 3] = 1.0
    return out


def inverse(a_T_b: Array) -> Array:
    """The inverse motion b_T_a."""
    rotation = np.swapaxes(a_T_b[..., :3, :3], -1, -2)
    return pose(rotation, -(rotation @ a_T_b[..., :3, 3:])[..., 0])


def transform(a_T_b: Array, points_b: Array) -> Array:
    """Map (..., n, 3) points of frame b into frame a."""
    return points_b @ np.swapaxes(a_T_b[..., :3, :3], -1, -2) + a_T_b[..., None, :3, 3]


def rotate(a_T_b: Array, vectors_b: Array) -> Array:
    """Turn (..., n, 3) directions of frame b into frame a."""
    return vectors_b @ np.swapaxes(a_T_b[..., :3, :3], -1, -2)


def rotation_exp(omega: Array) -> Array:
    """Rodrigues' formula: (..., 3) rotation vectors to (..., 3, 3)."""
    angle = np.linalg.norm(omega, axis=-1)[..., None, None]
    k = hat(omega)
    small = angle < 1e-8
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 1.0 - angle**2 / 6.0, np.sin(safe) / safe)
    b = np.where(small, 0.5 - angle**2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
    return np.asarray(np.eye(3) + a * k + b * (k @ k))


def rotation_log(rotation: Array) -> Array:
    """(..., 3, 3) to (..., 3) rotation vectors of length 0..pi."""
    flat = rotation.reshape(-1, 3, 3)
    out = np.empty((len(flat), 3))
    for i, r in enumerate(flat):
        out[i] = _log_one(r)
    return out.reshape(*rotation.shape[:-2], 3)


def _log_one(r: Array) -> Array:
    sin_axis = 0.5 * np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    sine, cosine = float(np.linalg.norm(sin_axis)), 0.5 * (float(np.trace(r)) - 1.0)
    angle = np.arctan2(sine, cosine)
    if sine > 1e-6:
        return np.asarray(sin_axis * (angle / sine))
    if cosine > 0.0:
        return sin_axis
    outer = 0.5 * (r + np.eye(3))
    axis = outer[int(np.argmax(np.diag(outer)))]
    return np.asarray(angle * axis / np.linalg.norm(axis))


def exp(xi: Array) -> Array:
    """(..., 6) tangent vectors to motions with rotation exp(omega) and translation V v."""
    omega, v = xi[..., :3], xi[..., 3:]
    angle = np.linalg.norm(omega, axis=-1)[..., None, None]
    k = hat(omega)
    small = angle < 1e-6
    safe = np.where(small, 1.0, angle)
    b = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    c = np.where(small, 1.0 / 6.0, (safe - np.sin(safe)) / safe**3)
    left_jacobian = np.eye(3) + b * k + c * (k @ k)
    return pose(rotation_exp(omega), (left_jacobian @ v[..., None])[..., 0])


def adjoint(a_T_b: Array) -> Array:
    """(..., 6, 6): a_T_b exp(xi) = exp(adjoint(a_T_b) xi) a_T_b."""
    rotation = a_T_b[..., :3, :3]
    out = np.zeros((*a_T_b.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = rotation
    out[..., 3:, :3] = hat(a_T_b[..., :3, 3]) @ rotation
    return out


def rotation_angle(rotation: Array) -> Array:
    """Geodesic angle of (..., 3, 3) rotations, radians in 0..pi; accurate near both ends."""
    frobenius = np.linalg.norm(rotation - np.eye(3), axis=(-2, -1))
    return np.asarray(2.0 * np.arcsin(np.clip(frobenius / np.sqrt(8.0), 0.0, 1.0)))


def distance(a: Array, b: Array) -> tuple[Array, Array]:
    """Rotation (rad) and translation (m) between motions of equal frames, broadcast."""
    delta = np.swapaxes(a[..., :3, :3], -1, -2) @ b[..., :3, :3]
    shift = np.linalg.norm(a[..., :3, 3] - b[..., :3, 3], axis=-1)
    return rotation_angle(delta), np.asarray(shift)


def rigid(matrix: Array) -> Array:
    """The (..., 4, 4) motion with the rotation nearest to that of a matrix, same translation."""
    return pose(nearest_rotation(matrix[..., :3, :3]), matrix[..., :3, 3])


def nearest_rotation(matrix: Array) -> Array:
    """The rotation closest to (..., 3, 3) matrices in the Frobenius norm."""
    u, _, vt = np.linalg.svd(matrix)
    sign = np.sign(np.linalg.det(u @ vt))
    u[..., :, 2] *= sign[..., None]
    return np.asarray(u @ vt)
