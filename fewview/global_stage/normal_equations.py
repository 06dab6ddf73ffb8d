"""Gauss-Newton over all poses of a component at once.

Poses are perturbed in the world, exp(xi) world_T_scan, xi = (rotation, translation). Every residual
here changes with the difference xi_source - xi_target of its two scans alone, so the normal
equations are a Laplacian of 6 x 6 blocks, one a term.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from fewview.geometry import se3
from fewview.global_stage.pose_graph import CAUCHY_SCALE, Edge, covariance
from fewview.types import Array

DAMPING = 1e-6
"""Keeps the equations solvable where nothing holds a scan, relative to their diagonal."""


@dataclass(frozen=True)
class Facing:
    """Points of two scans that lie on the same surface.

    Attributes:
        source, target: which poses carry the two scans.
        p, n_p: (n, 3) points and unit normals of the source, in its frame.
        q, n_q: (n, 3) the same of the target.
        information: (n,) 1 / variance of their distance along a normal, 1 / m^2.
        scale: of Geman-McClure's loss, metres.
    """

    source: int
    target: int
    p: Array
    n_p: Array
    q: Array
    n_q: Array
    information: Array
    scale: float

    def blocks(self, poses: Array) -> tuple[Array, Array]:
        """Hessian (6, 6) and gradient (6,) of the point-to-plane distances, along both normals,
        under (m, 4, 4) poses (the co-planar term of Sec. 3.3, Eq. 5, of two moving scans)."""
        x, m = _placed(poses[self.source], self.p, self.n_p)
        y, n = _placed(poses[self.target], self.q, self.n_q)
        rows = np.concatenate(
            [np.hstack([np.cross(x, n), n]), np.hstack([np.cross(y, m), m])], axis=0
        )
        gap = x - y
        residual = np.concatenate([(gap * n).sum(axis=1), (gap * m).sum(axis=1)])
        robust = (self.scale**2 / (self.scale**2 + residual**2)) ** 2
        weighted = rows.T * (np.tile(self.information, 2) * robust)
        return weighted @ rows, weighted @ residual


@dataclass(frozen=True)
class Link:
    """A selected candidate as between-factor, with the covariance and loss of the pose graph.

    Attributes:
        source, target: which poses carry the two scans.
        target_T_source: (4, 4).
        information: (6, 6), of xi in target_T_source @ exp(xi).
    """

    source: int
    target: int
    target_T_source: Array
    information: Array

    @staticmethod
    def of(source: int, target: int, edge: Edge) -> Link:
        """The factor of ``edge`` between two poses."""
        information = np.asarray(np.linalg.inv(covariance(edge.candidate)), dtype=np.float64)
        return Link(source, target, edge.candidate.target_T_source, information)

    def blocks(self, poses: Array) -> tuple[Array, Array]:
        """Hessian (6, 6) and gradient (6,), for errors small enough to be added."""
        found = se3.inverse(poses[self.target]) @ poses[self.source]
        error = se3.inverse(self.target_T_source) @ found
        residual = np.concatenate([se3.rotation_log(error[:3, :3]), error[:3, 3]])
        squared = residual @ self.information @ residual
        jacobian = se3.adjoint(se3.inverse(poses[self.source]))
        weighted = jacobian.T @ self.information / (1.0 + squared / CAUCHY_SCALE**2)
        return weighted @ jacobian, weighted @ residual


def gauss_newton_step(
    poses: Array, terms: Sequence[Facing | Link], fixed: Collection[int]
) -> Array:
    """(m, 6) step xi that lowers the sum of all terms; zero for the ``fixed`` poses."""
    count = len(poses)
    hessian, gradient = np.zeros((count, count, 6, 6)), np.zeros((count, 6))
    for term in terms:
        i, j = term.source, term.target
        block, slope = term.blocks(poses)
        hessian[i, i] += block
        hessian[j, j] += block
        hessian[i, j] -= block
        hessian[j, i] -= block
        gradient[i] += slope
        gradient[j] -= slope
    free = np.array([k for k in range(count) if k not in fixed], dtype=np.int64)
    step = np.zeros((count, 6))
    if len(free):
        size = 6 * len(free)
        dense = hessian[np.ix_(free, free)].transpose(0, 2, 1, 3).reshape(size, size)
        damped = dense + DAMPING * np.diag(np.diag(dense) + 1.0)
        step[free] = -np.linalg.solve(damped, gradient[free].ravel()).reshape(-1, 6)
    return step


def _placed(pose: Array, points: Array, normals: Array) -> tuple[Array, Array]:
    return se3.transform(pose, points), se3.rotate(pose, normals)
