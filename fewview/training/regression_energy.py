"""The energy of the robust regression (Sec. 3.3, Eq. 5 and 6) in torch, for one pair and one pose.

As in `refinement.regression`, where its Jacobians are analytic; here all that enters it, poses,
alphas, relation probabilities, positions and normals, can be differentiated by.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from fewview.config import RefinementConfig
from fewview.refinement.regression import Matches
from fewview.refinement.relations import Relations
from fewview.types import Array

SCALES = ("alpha_r", "alpha_0_m", "alpha_1_m", "alpha_2", "alpha_3", "alpha_match_m")
"""The settings of the refinement that l_4 trains."""
FIXED = ("match_weight",)
"""Settings that its energy needs too."""


@dataclass(frozen=True)
class FeaturePairs:
    """Pairs of features: positions and normals (n, 3), each in its scan's frame, weights (n,)."""

    source: Tensor
    source_normals: Tensor
    target: Tensor
    target_normals: Tensor
    weight: Tensor

    @staticmethod
    def of(
        source: Array, source_normals: Array, target: Array, target_normals: Array, weight: Array
    ) -> FeaturePairs:
        """Those of the pairs that have a weight."""
        there = weight > 0
        columns = (source, source_normals, target, target_normals, weight)
        return FeaturePairs(*(_tensor(column[there]) for column in columns))


@dataclass(frozen=True)
class RegressionProblem:
    """One iteration of the robust regression.

    Attributes:
        start: (4, 4) pose target_T_source from which it sets out; truth: (4, 4) the true one.
        near: nearest neighbours under the start.
        related: m sampled feature pairs with the probabilities (m,) of their relations.
        matched: (k, 3) matched features on either side and their weights (k,).
    """

    start: Tensor
    truth: Tensor
    near: FeaturePairs
    related: FeaturePairs
    coplanar: Tensor
    parallel: Tensor
    perpendicular: Tensor
    matched_source: Tensor
    matched_target: Tensor
    matched_weight: Tensor

    @staticmethod
    def of(
        start: Array, truth: Array, near: FeaturePairs, relations: Relations, matches: Matches
    ) -> RegressionProblem:
        """The problem of relations and matches under one candidate pose, ``start``."""
        r = relations
        columns = (r.source, r.source_normals, r.target, r.target_normals, r.weight)
        probabilities = (r.coplanar[0], r.parallel[0], r.perpendicular[0])
        held = matches.weight[0] > 0
        matched = (matches.source[held], matches.target[held], matches.weight[0, held])
        return RegressionProblem(
            _tensor(start),
            _tensor(truth),
            near,
            FeaturePairs(*map(_tensor, columns)),
            *map(_tensor, probabilities),
            *map(_tensor, matched),
        )


def scales_of(config: RefinementConfig) -> dict[str, Tensor]:
    """`SCALES` and `FIXED` of the settings."""
    return {
        name: torch.tensor(getattr(config, name), dtype=torch.float64) for name in SCALES + FIXED
    }


def robust_weights(problem: RegressionProblem, scales: Mapping[str, Tensor]) -> list[Tensor]:
    """Weights (n,) of the terms of `residuals`, set under the start (Eq. 6)."""
    related = scales["alpha_r"] * problem.related.weight
    base = (
        problem.near.weight,
        related * problem.coplanar,
        related * problem.parallel,
        related * problem.perpendicular,
        scales["match_weight"] * problem.matched_weight,
    )
    alphas = [scales[name].square() for name in SCALES[1:]]
    rows = residuals(problem, torch.zeros(6, dtype=torch.float64))
    return [
        weight * alpha / (alpha + r.square().sum(dim=1))
        for weight, alpha, r in zip(base, alphas, rows, strict=True)
    ]


def normal_equations(
    problem: RegressionProblem, weights: list[Tensor], xi: Tensor
) -> tuple[Tensor, Tensor]:
    """Gauss-Newton Hessian (6, 6) and gradient (6,) of the energy without damping."""

    def stacked(at: Tensor) -> tuple[Tensor, Tensor]:
        rows = torch.cat([r.flatten() for r in residuals(problem, at)])
        return rows, rows

    jacobian, rows = torch.func.jacfwd(stacked, has_aux=True)(xi)
    sizes = [r.shape[1] for r in residuals(problem, xi)]
    weight = torch.cat([w.repeat_interleave(n) for w, n in zip(weights, sizes, strict=True)])
    weighted = jacobian * weight[:, None]
    return weighted.T @ jacobian, weighted.T @ rows


def residuals(problem: RegressionProblem, xi: Tensor) -> list[Tensor]:
    """(n, r) of the nearest neighbours, of the three relations and of the matched features."""
    pose = exp(xi) @ problem.start
    turned = problem.related.source_normals @ pose[:3, :3].T
    normals = problem.related.target_normals
    matched = problem.matched_source @ pose[:3, :3].T + pose[:3, 3]
    return [
        _coplanar(problem.near, pose),
        _coplanar(problem.related, pose),
        torch.linalg.cross(turned, normals),
        (turned * normals).sum(dim=1, keepdim=True),
        matched - problem.matched_target,
    ]


def _coplanar(pairs: FeaturePairs, pose: Tensor) -> Tensor:
    gap = pairs.source @ pose[:3, :3].T + pose[:3, 3] - pairs.target
    turned = pairs.source_normals @ pose[:3, :3].T
    return torch.stack([(gap * pairs.target_normals).sum(dim=1), (gap * turned).sum(dim=1)], dim=1)


def exp(xi: Tensor) -> Tensor:
    """(6,) tangent vector, rotation before translation, to a motion (4, 4); as `se3.exp`."""
    x, y, z, a, b, c = xi.unbind()
    nothing = torch.zeros_like(x)
    rows = [[nothing, -z, y, a], [z, nothing, -x, b], [-y, x, nothing, c], [nothing] * 4]
    motion: Tensor = torch.linalg.matrix_exp(torch.stack([torch.stack(row) for row in rows]))
    return motion


def _tensor(values: Array) -> Tensor:
    return torch.from_numpy(values).double()
