"""The consistency matrix of `matching.consistency` in torch, differentiable by all that enters it.

Same formula, same pairs of correspondences; only matching's cut, which sets entries below
`MIN_ENTRY` to zero and has no gradient, may be a gradual one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from fewview.matching.consistency import (
    MIN_ENTRY,
    MIN_LENGTH_M,
    UPRIGHT_COS,
    CandidateMatches,
)
from fewview.types import BoolArray

FADED = 4.0
"""Widths of the cut below `MIN_ENTRY` at which an entry is left out."""
STRAIGHT = 1e-6
"""Cosines are kept this far from 1 and -1, where the angle has no derivative."""
NOTHING = 1e-12
"""Keeps the turn between vectors without a horizontal part at 0, with a derivative."""


@dataclass(frozen=True)
class SpectralProblem:
    """Candidate correspondences of one pair and which of them are right.

    Attributes:
        source, target, source_normals, target_normals: (m, 3), each in its scan's frame.
        similarity: (m,) s_c.
        kinds: names of the feature kinds; kind: (m,) index into them.
        indices: (m, 2) into the features of that kind.
        angles_known: (m,) whether angles with the normals count.
        up: (2, 3) of source and target when the scans count as levelled.
        right: (m,) whether the true pose explains a correspondence; at least one.
    """

    source: Tensor
    target: Tensor
    source_normals: Tensor
    target_normals: Tensor
    similarity: Tensor
    kinds: tuple[str, ...]
    kind: Tensor
    indices: Tensor
    angles_known: Tensor
    up: Tensor | None
    right: Tensor

    @staticmethod
    def of(
        matches: CandidateMatches, right: BoolArray, dtype: torch.dtype = torch.float32
    ) -> SpectralProblem:
        """The problem of m >= 3 matches, of which ``right`` (m,) are right."""
        known, up = matches.normals_known, matches.up
        if up is not None:
            lean = [matches.source_normals @ up[0], matches.target_normals @ up[1]]
            known = known & (np.abs(lean).max(axis=0) < UPRIGHT_COS)
        return SpectralProblem(
            source=torch.from_numpy(matches.source).to(dtype),
            target=torch.from_numpy(matches.target).to(dtype),
            source_normals=torch.from_numpy(matches.source_normals).to(dtype),
            target_normals=torch.from_numpy(matches.target_normals).to(dtype),
            similarity=torch.from_numpy(matches.similarity).to(dtype),
            kinds=tuple(matches.kinds),
            kind=torch.from_numpy(matches.kind),
            indices=torch.from_numpy(matches.indices),
            angles_known=torch.from_numpy(known),
            up=None if up is None else torch.from_numpy(up).to(dtype),
            right=torch.from_numpy(right),
        )


@dataclass(frozen=True)
class Entries:
    """The entries of a symmetric (m, m) matrix above its diagonal: rows (e,), columns (e,) and
    values (e,)."""

    row: Tensor
    column: Tensor
    value: Tensor

    def times(self, vector: Tensor) -> Tensor:
        """The matrix times a vector (m,)."""
        out = torch.zeros_like(vector)
        out = out.index_add(0, self.row, self.value * vector[self.column])
        return out.index_add(0, self.column, self.value * vector[self.row])


def consistency(problem: SpectralProblem, gammas: Mapping[str, Tensor], fade: float) -> Entries:
    """The matrix of a problem.

    Args:
        problem: the candidate correspondences.
        gammas: of each kind, (3,): length in metres, normal and direction angles in radians.
        fade: entries fade out over this width around `MIN_ENTRY`; 0: with matching's jump.
    """
    scale = torch.stack([gammas[name] for name in problem.kinds])[problem.kind]
    variance = scale.square()
    i, j = _worth_comparing(problem, variance[:, 0].detach(), MIN_ENTRY - FADED * fade)
    ups = (None, None) if problem.up is None else problem.up.unbind()
    a = _invariants(problem.source, problem.source_normals, i, j, ups[0])
    b = _invariants(problem.target, problem.target_normals, i, j, ups[1])
    change = a - b
    if problem.up is not None:
        turned = torch.remainder(change[:, 1:] + math.pi, 2.0 * math.pi) - math.pi
        change = torch.cat([change[:, :1], turned], dim=1)
    known = problem.angles_known
    used = torch.stack([torch.ones_like(known[i]), known[i] & known[j], known[i], known[j]], dim=1)
    both = (variance[i] + variance[j])[:, [0, 1, 2, 2]]
    geometry = torch.exp(-(used * change.square() / both).sum(dim=1))
    kept = torch.sigmoid((geometry - MIN_ENTRY) / fade) if fade else geometry > MIN_ENTRY
    return Entries(i, j, kept * geometry * problem.similarity[i] * problem.similarity[j])


@torch.no_grad()
def _worth_comparing(
    problem: SpectralProblem, variance: Tensor, least: float
) -> tuple[Tensor, Tensor]:
    """Pairs i < j of different features whose lengths alone leave the entry above ``least``."""
    p, q = (_lengths(points) for points in (problem.source, problem.target))
    fits = (p - q).square() < -math.log(least) * (variance[:, None] + variance[None])
    fits &= torch.minimum(p, q) > MIN_LENGTH_M
    kind, indices = problem.kind, problem.indices
    shared = (indices[:, None] == indices[None]).any(dim=2) & (kind[:, None] == kind[None])
    i, j = (fits & ~shared).triu(diagonal=1).nonzero(as_tuple=True)
    return i, j


def _lengths(points: Tensor) -> Tensor:
    return torch.cdist(points, points, compute_mode="donot_use_mm_for_euclid_dist")


def _invariants(points: Tensor, normals: Tensor, i: Tensor, j: Tensor, up: Tensor | None) -> Tensor:
    """(e, 4) length and three angles of pairs of features."""
    step = points[i] - points[j]
    length = step.norm(dim=1)
    step = step / length[:, None]
    return torch.stack(
        [
            length,
            _angle(normals[i], normals[j], up),
            _angle(normals[i], step, up),
            _angle(normals[j], step, up),
        ],
        dim=1,
    )


def _angle(a: Tensor, b: Tensor, up: Tensor | None) -> Tensor:
    """Angles 0..pi between unit vectors, or -pi..pi about ``up`` from ``a`` to ``b``."""
    cosine = (a * b).sum(dim=1)
    if up is None:
        return torch.acos(cosine.clamp(STRAIGHT - 1.0, 1.0 - STRAIGHT))
    across = torch.linalg.cross(a, b) @ up
    return torch.atan2(across, cosine - (a @ up) * (b @ up) + NOTHING)
