"""The least-squares terms with their Jacobians, and the Gauss-Newton step over all of them.

Unknowns are a left increment xi (rotation, translation) of every world_T_scan, then for every
structure two turns of its normal and a shift along it. Within a term residuals share the term's
weight in proportion to their affinity, as in the authors' program.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from benchmark.backends.fine_to_coarse.correspondences import PointPairs
from benchmark.backends.fine_to_coarse.structures import Relation
from fewview.geometry import se3
from fewview.types import Array, IntArray

_POSE, _PLANE = 6, 3


@dataclass(frozen=True)
class Term:
    """Linearised residuals.

    Attributes:
        columns: (n, k) unknowns that each depends on.
        jacobian: (n, k).
        residual: (n,).
        affinity: (n,).
        weight: of the whole term.
    """

    columns: IntArray
    jacobian: Array
    residual: Array
    affinity: Array
    weight: float


@dataclass(frozen=True)
class State:
    """Unknowns.

    Attributes:
        poses: (n, 4, 4) world_T_scan.
        centres: (m, 3) a point of each structure, fixed.
        normals: (m, 3) of the structures, unit.
        shifts: (m,) metres of each structure's plane from its centre along its normal.
    """

    poses: Array
    centres: Array
    normals: Array
    shifts: Array

    @property
    def bases(self) -> Array:
        """(m, 3, 2) orthonormal tangents of the normals."""
        return np.asarray(np.linalg.svd(self.normals[:, None])[2][:, 1:].swapaxes(-1, -2))

    def moved(self, step: Array) -> State:
        """The state after an increment (6 n + 3 m,)."""
        split = _POSE * len(self.poses)
        xi, plane = step[:split].reshape(-1, _POSE), step[split:].reshape(-1, _PLANE)
        normals = self.normals + np.einsum("mij,mj->mi", self.bases, plane[:, :2])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return State(se3.exp(xi) @ self.poses, self.centres, normals, self.shifts + plane[:, 2])


@dataclass(frozen=True)
class Tie:
    """A measured motion a_T_b of two frames, held at three points ``radius`` m from b."""

    a: int
    b: int
    a_T_b: Array
    radius: float


def point_to_plane(state: State, pairs: PointPairs, weight: float) -> Term:
    """Distances of points to the tangent planes of their closest points."""
    x = _to_world(state, pairs.frames, pairs.points)
    y = _to_world(state, pairs.other_frames, pairs.other_points)
    normals = np.einsum("nij,nj->ni", state.poses[pairs.other_frames, :3, :3], pairs.other_normals)
    half = np.concatenate([np.cross(x, normals), normals], axis=1)
    columns = np.concatenate([_pose(pairs.frames), _pose(pairs.other_frames)], axis=1)
    residual = np.einsum("ni,ni->n", normals, x - y)
    return Term(columns, np.concatenate([half, -half], axis=1), residual, pairs.affinity, weight)


def point_on_structure(
    state: State, frames: IntArray, points: Array, structures: IntArray, weight: float
) -> Term:
    """Distances of points (n, 3) of frames' planes to the structures they belong to."""
    x = _to_world(state, frames, points)
    normals = state.normals[structures]
    arm = x - state.centres[structures]
    turn = np.einsum("nij,ni->nj", state.bases[structures], arm)
    jacobian = [np.cross(x, normals), normals, turn, np.full((len(x), 1), -1.0)]
    columns = [_pose(frames), _plane(state, structures)]
    residual = np.einsum("ni,ni->n", normals, arm) - state.shifts[structures]
    return Term(
        np.concatenate(columns, axis=1),
        np.concatenate(jacobian, axis=1),
        residual,
        np.ones(len(x)),
        weight,
    )


def related(state: State, relations: Sequence[Relation], weight: float) -> Term:
    """Differences of parallel normals, cosines of perpendicular ones."""
    level = [r for r in relations if r.cosine != 0]
    across = [r for r in relations if r.cosine == 0]
    a, b = _sides(level)
    cosine = np.array([r.cosine for r in level], dtype=np.float64)
    jacobian = np.concatenate([-cosine[:, None, None] * state.bases[a], state.bases[b]], axis=2)
    c, d = _sides(across)
    towards_d = np.einsum("ni,nij->nj", state.normals[d], state.bases[c])
    towards_c = np.einsum("ni,nij->nj", state.normals[c], state.bases[d])
    dots = np.einsum("ni,ni->n", state.normals[c], state.normals[d])
    columns = [
        np.concatenate([_plane(state, i)[:, :2] for i in s], axis=1) for s in ((a, b), (c, d))
    ]
    return Term(
        np.concatenate([np.repeat(columns[0], 3, axis=0), columns[1]]),
        np.concatenate([jacobian.reshape(-1, 4), np.hstack([towards_d, towards_c])]),
        np.concatenate([(state.normals[b] - cosine[:, None] * state.normals[a]).ravel(), dots]),
        np.array([r.score for r in level for _ in range(3)] + [r.score for r in across]),
        weight,
    )


def tied(state: State, ties: Sequence[Tie], weight: float) -> Term:
    """How far points of frames stand from where the measured motions put them."""
    a = np.repeat(np.array([tie.a for tie in ties], dtype=np.int64), 3)
    b = np.repeat(np.array([tie.b for tie in ties], dtype=np.int64), 3)
    in_b = np.array([tie.radius * np.eye(3) for tie in ties]).reshape(-1, 3)
    in_a = np.array([se3.transform(t.a_T_b, t.radius * np.eye(3)) for t in ties]).reshape(-1, 3)
    x, y = _to_world(state, b, in_b), _to_world(state, a, in_a)
    eye = np.broadcast_to(np.eye(3), (len(x), 3, 3))
    jacobian = np.concatenate([-se3.hat(x), eye, se3.hat(y), -eye], axis=2)
    columns = np.repeat(np.concatenate([_pose(b), _pose(a)], axis=1), 3, axis=0)
    residual = (x - y).ravel()
    return Term(columns, jacobian.reshape(-1, 12), residual, np.ones(len(residual)), weight)


def step(terms: Sequence[Term], unknowns: int, inertia: float) -> Array:
    """The Gauss-Newton increment (unknowns,); inertia resists it in all unknowns alike."""
    normal = np.diag(np.full(unknowns, inertia / unknowns))
    right = np.zeros(unknowns)
    for term in terms:
        if not len(term.residual):
            continue
        rows, width = term.columns.shape
        shape = (rows, unknowns)
        starts = np.arange(0, rows * width + 1, width)
        jacobian = sparse.csr_array((term.jacobian.ravel(), term.columns.ravel(), starts), shape)
        share = term.weight * term.affinity / term.affinity.sum()
        normal += (jacobian.T @ (jacobian * share[:, None])).toarray()
        right -= jacobian.T @ (share * term.residual)
    return np.asarray(np.linalg.solve(normal, right), dtype=np.float64)


def _to_world(state: State, frames: IntArray, points: Array) -> Array:
    poses = state.poses[frames]
    return np.asarray(np.einsum("nij,nj->ni", poses[:, :3, :3], points) + poses[:, :3, 3])


def _sides(relations: Sequence[Relation]) -> tuple[IntArray, IntArray]:
    sides = np.array([(r.a, r.b) for r in relations], dtype=np.int64).reshape(-1, 2)
    return sides[:, 0], sides[:, 1]


def _pose(frames: IntArray) -> IntArray:
    return frames[:, None] * _POSE + np.arange(_POSE)


def _plane(state: State, structures: IntArray) -> IntArray:
    return len(state.poses) * _POSE + structures[:, None] * _PLANE + np.arange(_PLANE)
