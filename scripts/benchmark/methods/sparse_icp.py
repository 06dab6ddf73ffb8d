"""Sparse ICP (Bouaziz, Tagliasacchi and Pauly, SGP 2013): ICP that minimises a p-norm, p < 1.

Residuals are split off as variables of their own, z = residual, and the augmented Lagrangian is
minimised in turns over z, where it has a closed form but for a short fixed-point iteration (the
shrink operator), over the motion, which is least squares, and over the multipliers (Sec. 4).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import open3d as o3d
from scipy.spatial import KDTree

from benchmark.methods.clouds import (
    ICP_DISTANCES_M,
    MIN_POINTS,
    assess,
    cloud_of,
    registration,
)
from benchmark.methods.interface import Answer, PairMethod
from fewview.geometry import se3
from fewview.types import Array, Frame

SOURCE_POINTS = 800
"""Source points that look for a partner."""
SHRINK_STEPS = 3


@dataclass(frozen=True)
class Parameters:
    """The authors' defaults, with the p of their experiments; lengths in metres."""

    p: float = 0.4
    """Norm of the residuals."""
    mu: float = 10.0
    """First weight of the penalty."""
    alpha: float = 1.2
    """By which the weight grows every outer iteration ..."""
    max_mu: float = 1e5
    """... up to this."""
    max_icp: int = 100
    """Rounds of closest points."""
    max_outer: int = 100
    """Multiplier updates a round."""
    max_inner: int = 1
    """Alternations between z and the motion an update; 1 is ADMM."""
    stop: float = 1e-5
    """Converged when no residual changes by more."""


DEFAULTS = Parameters()


class SparseICP(PairMethod):
    """Sparse ICP from the identity on 5 cm voxels, `SOURCE_POINTS` of the source.

    Args:
        point_to_plane: which residual; points to points otherwise.
    """

    def __init__(self, point_to_plane: bool = True) -> None:
        self.point_to_plane = point_to_plane

    def prepare(self, frame: Frame, turn: int = 0) -> o3d.geometry.PointCloud | None:
        """The frame's cloud; None when next to no depth was measured."""
        cloud = cloud_of(frame)
        return cloud if len(cloud.points) >= MIN_POINTS else None

    def match(
        self, source: o3d.geometry.PointCloud | None, target: o3d.geometry.PointCloud | None
    ) -> Answer:
        """One candidate; its score is the number of source points with a neighbour at 5 cm."""
        if source is None or target is None:
            return Answer()
        normals = np.asarray(target.normals) if self.point_to_plane else None
        pose = sparse_icp(thinned(source), np.asarray(target.points), normals, np.eye(4))
        found = registration.evaluate_registration(source, target, ICP_DISTANCES_M[-1], pose)
        return Answer((assess(source, target, pose, len(found.correspondence_set)),))


def thinned(cloud: o3d.geometry.PointCloud) -> Array:
    """At most `SOURCE_POINTS` (n, 3) of its points, the same each time."""
    points = np.asarray(cloud.points)
    rng = np.random.default_rng(0)
    return points[rng.choice(len(points), min(SOURCE_POINTS, len(points)), replace=False)]


def sparse_icp(
    source_points: Array,
    target_points: Array,
    target_normals: Array | None,
    start: Array,
    parameters: Parameters = DEFAULTS,
) -> Array:
    """target_T_source (4, 4) that minimises the p-norm of the distances to closest points.

    Args:
        source_points: (n, 3) in the source frame, metres.
        target_points: (m, 3) in the target frame.
        target_normals: (m, 3) unit normals for point-to-plane residuals, or None for
            point-to-point ones.
        start: (4, 4) target_T_source to start from.
        parameters: settings.
    """
    tree, pose = KDTree(target_points), start
    for _ in range(parameters.max_icp):
        moved = se3.transform(pose, source_points)
        _, nearest = tree.query(moved)
        normals = None if target_normals is None else target_normals[nearest]
        step = _align(moved, target_points[nearest], normals, parameters)
        pose = step @ pose
        if np.linalg.norm(se3.transform(step, moved) - moved, axis=1).max() < parameters.stop:
            break
    return pose


def shrink(vectors: Array, mu: float, p: float) -> Array:
    """The z (n, d) that minimises |z|^p + mu / 2 |z - v|^2 for each row v (Eq. 11 and 12)."""
    length = np.linalg.norm(vectors, axis=-1)
    smallest = (2.0 / mu * (1.0 - p)) ** (1.0 / (2.0 - p))
    threshold = smallest + p / mu * smallest ** (p - 1.0)
    large = length > threshold
    scale = 0.5 * (smallest / length[large] + 1.0)
    for _ in range(SHRINK_STEPS):
        scale = 1.0 - p / mu * length[large] ** (p - 2.0) * scale ** (p - 1.0)
    out = np.zeros_like(vectors)
    out[large] = scale[:, None] * vectors[large]
    return out


def _align(points: Array, partners: Array, normals: Array | None, parameters: Parameters) -> Array:
    """The motion of (n, 3) points onto their partners in the p-norm, linearised."""
    centre = points.mean(axis=0)
    start, jacobian = _linearised(points, partners, normals, centre)
    solve = _solver(jacobian)
    motion, mu = np.zeros(6), parameters.mu
    residual, multiplier = start, np.zeros_like(start)
    for _ in range(parameters.max_outer):
        for _ in range(parameters.max_inner):
            wanted = shrink(residual + multiplier / mu, mu, parameters.p)
            motion = solve @ (wanted - multiplier / mu - start).ravel()
            before, residual = residual, start + (jacobian @ motion).reshape(start.shape)
            move = float(np.abs(residual - before).max())
            if move < parameters.stop:
                break
        gap = residual - wanted
        multiplier = multiplier + mu * gap
        mu = min(mu * parameters.alpha, parameters.max_mu)
        if max(move, float(np.abs(gap).max())) < parameters.stop:
            break
    turn = se3.rotation_exp(motion[:3])
    return se3.pose(turn, centre - turn @ centre + motion[3:])


def _linearised(
    points: Array, partners: Array, normals: Array | None, centre: Array
) -> tuple[Array, Array]:
    """Residuals (n, 3) or (n, 1), and their Jacobian (n * 3 or n, 6) for a turn about ``centre``
    and a shift."""
    offset, arm = points - partners, points - centre
    if normals is None:
        shift = np.broadcast_to(np.eye(3), (len(points), 3, 3))
        return offset, np.concatenate([-se3.hat(arm), shift], axis=-1).reshape(-1, 6)
    distance = np.einsum("ni,ni->n", offset, normals)
    return distance[:, None], np.hstack([np.cross(arm, normals), normals])


def _solver(jacobian: Array) -> Array:
    """The least-squares inverse (6, m), damped where the surface leaves a motion free."""
    normal = jacobian.T @ jacobian + 1e-9 * len(jacobian) * np.eye(6)
    return np.asarray(np.linalg.solve(normal, jacobian.T))
