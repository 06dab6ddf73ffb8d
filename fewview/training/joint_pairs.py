"""What l_3 and l_4 see of pairs of training views, differentiable by the networks' answers."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from fewview.completion.panorama.ring import FORWARD
from fewview.completion.room_matches import BEST, DESCRIPTOR_SCALE, HEIGHT_M, INCLINATION
from fewview.config import RefinementConfig
from fewview.matching.consistency import UPRIGHT_COS
from fewview.refinement.learned_relations import SHARES
from fewview.refinement.relation_network import RelationOutput
from fewview.training.consistency import SpectralProblem
from fewview.training.foreseen import Foreseen
from fewview.training.problem import Batch
from fewview.training.regression_energy import FeaturePairs, RegressionProblem

KIND = "panorama"
MATCHES = 400
"""The most correspondences of a pair."""
RIGHT_M = 0.25
"""How far the truth may leave a right correspondence apart."""
MIN_RIGHT = 5
"""Pairs with fewer right ones teach nothing about l_3."""
STANDS_FOR = 20.0
"""Points that a sampled point pair stands for, about as many as a pair of patches does."""
FACING = 0.7


def log_depth(points: Tensor) -> Tensor:
    """(..., 3) points of level frames to the logarithm of their planar depth in the ring."""
    forward = torch.from_numpy(FORWARD).to(points)
    return (points @ forward.T).amax(dim=-1).clamp_min(0.05).log()


def spectral_problems(seen: Foreseen, batch: Batch) -> Iterator[SpectralProblem]:
    """Matched descriptors, as matching finds them, of the pairs of a batch that have right ones."""
    for a, b, truth in _pairs(batch, len(batch["source"])):
        points, normals = seen.scans.points, seen.scans.normals
        there = points[a] @ truth[:3, :3].T + truth[:3, 3]
        similarity = _similarity(seen, a, b, truth)
        with torch.no_grad():
            i, j = _matched(similarity)
            right = (there[i] - points[b][j]).norm(dim=1) < RIGHT_M
        if int(right.sum()) < MIN_RIGHT:
            continue
        p, q = normals[a][i], normals[b][j]
        level = torch.tensor([[0.0, 0.0, 1.0]] * 2, device=p.device)
        lean = torch.maximum(p[:, 2].abs(), q[:, 2].abs())
        yield SpectralProblem(
            source=points[a][i],
            target=points[b][j],
            source_normals=p,
            target_normals=q,
            similarity=similarity[i, j],
            kinds=(KIND,),
            kind=torch.zeros_like(i),
            indices=torch.stack([i, j], dim=1),
            angles_known=lean.detach() < UPRIGHT_COS,
            up=level,
            right=right,
        )


def regression_problems(
    seen: Foreseen, output: RelationOutput, batch: Batch, count: int
) -> Iterator[RegressionProblem]:
    """One iteration from the true poses of the first ``count`` pairs of a batch, as in the paper,
    with the relations that were predicted under perturbed ones."""
    shares = torch.from_numpy(SHARES).to(output.relations.device)
    for number, (a, b, truth) in enumerate(_pairs(batch, count)):
        scans = seen.scans
        p, n, q, m = (
            values[k].double() for k in (a, b) for values in (scans.points, scans.normals)
        )
        start = truth.double()
        i, j = batch["source_point"][number], batch["target_point"][number]
        chance = output.relations[number].double().softmax(dim=1) * shares
        chance = chance / chance.sum(dim=1, keepdim=True)
        sure = (scans.confidence[a][i] * scans.confidence[b][j]).double()
        vectors = torch.zeros(0, 3, dtype=torch.float64)
        yield RegressionProblem(
            start=start,
            truth=start,
            near=_near(p, n, q, m, scans.predicted[a], scans.predicted[b], start),
            related=FeaturePairs(p[i], n[i], q[j], m[j], STANDS_FOR * sure),
            coplanar=chance[:, 1],
            parallel=chance[:, 2],
            perpendicular=chance[:, 3],
            matched_source=vectors,
            matched_target=vectors,
            matched_weight=vectors[:, 0],
        )


def _pairs(batch: Batch, count: int) -> Iterator[tuple[int, int, Tensor]]:
    """Views and true poses (4, 4) of the first pairs."""
    for k in range(count):
        yield int(batch["source"][k]), int(batch["target"][k]), batch["true_pose"][k]


def _similarity(seen: Foreseen, a: int, b: int, truth: Tensor) -> Tensor:
    """(N, N) s_c of all points of two views; 0 where levelling forbids a match."""
    scans, descriptors = seen.scans, seen.descriptors
    squared = 2.0 - 2.0 * descriptors[a] @ descriptors[b].T
    similarity = torch.exp(-squared / (2.0 * DESCRIPTOR_SCALE**2))
    sure = (scans.confidence[a][:, None] * scans.confidence[b]).clamp_min(1e-6).sqrt()
    rise = scans.points[a][:, None, 2] + truth[2, 3] - scans.points[b][:, 2]
    lean = scans.normals[a][:, None, 2] - scans.normals[b][:, 2]
    alike = (rise.abs() < HEIGHT_M) & (lean.abs() < INCLINATION)
    alike = alike & (scans.predicted[a][:, None] | scans.predicted[b])
    shown = scans.pooled & (scans.pixels >= 0)
    return similarity * sure * (alike & shown[a][:, None] & shown[b])


def _matched(similarity: Tensor) -> tuple[Tensor, Tensor]:
    """Rows and columns of the most similar among the `BEST` of both their row and column."""
    best = similarity > 0
    for axis in (0, 1):
        best &= similarity >= similarity.topk(BEST, dim=axis).values.amin(dim=axis, keepdim=True)
    i, j = best.nonzero(as_tuple=True)
    order = similarity[i, j].argsort(descending=True)[:MATCHES]
    return i[order], j[order]


def _near(
    p: Tensor, n: Tensor, q: Tensor, m: Tensor, foreseen_p: Tensor, foreseen_q: Tensor, pose: Tensor
) -> FeaturePairs:
    """Of measured points (N, 3) with normals, the nearest ones under a pose that face alike."""
    with torch.no_grad():
        distance = torch.cdist(p @ pose[:3, :3].T + pose[:3, 3], q)
        distance[foreseen_p] = torch.inf
        distance[:, foreseen_q] = torch.inf
        least, j = distance.min(dim=1)
        alike = ((n @ pose[:3, :3].T) * m[j]).sum(dim=1) > FACING
        i = ((least < RefinementConfig().neighbour_m[0]) & alike).nonzero()[:, 0]
    j = j[i]
    return FeaturePairs(p[i], n[i], q[j], m[j], torch.ones(len(i), dtype=p.dtype))
