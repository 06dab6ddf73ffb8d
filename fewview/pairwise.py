"""One pair of completed scans to its K relative poses, each with evidence and a probability."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from fewview.completion import KINDS
from fewview.config import Config
from fewview.geometry import se3
from fewview.matching.consistency import CandidateMatches, consistency_matrix, stack
from fewview.matching.manhattan import TopDown, manhattan_poses, top_down
from fewview.matching.spectral import agreeing, top_poses
from fewview.probability import ProbabilityModel, shipped_model
from fewview.refinement.evidence import (
    depth_bounds,
    gravity_disagreement,
    surface_agreement,
    visible_agreement,
    yaw_disagreement,
)
from fewview.refinement.regression import Matches, Refined, refine
from fewview.refinement.relations import PatchRelations
from fewview.types import (
    Array,
    BoolArray,
    CandidateOrigin,
    CompletedScan,
    Evidence,
    FloatArray,
    IntArray,
    PairResult,
    PairStatus,
    PoseCandidate,
    Representation,
)

CERTAIN_INLIERS = 40
MIN_BELIEVABLE = 0.05
SUPPORT_SCALE = 2.0


@dataclass(frozen=True)
class PreparedScan:
    """A completed scan with what every pair would otherwise compute again."""

    scan: CompletedScan
    tree: cKDTree
    depth_min: FloatArray
    depth_max: FloatArray
    raster: TopDown


def prepare(scan: CompletedScan) -> PreparedScan:
    """Search structures of one scan."""
    low, high = depth_bounds(scan.depth)
    return PreparedScan(scan, cKDTree(scan.surface.points), low, high, top_down(scan))


@dataclass(frozen=True)
class _Proposals:
    """Initial poses (K, 4, 4), where they come from, their scores."""

    poses: Array
    origins: tuple[CandidateOrigin, ...]
    scores: Array


def match_pair(
    source: PreparedScan,
    target: PreparedScan,
    indices: tuple[int, int],
    config: Config,
    model: ProbabilityModel | None = None,
) -> PairResult:
    """Top-K relative poses target_T_source of two scans.

    Args:
        source, target: the scans.
        indices: their positions in the scan list, kept in the result.
        config: settings.
        model: probability model; the shipped one when not given.

    Returns:
        candidates by falling probability, no two within the duplicate tolerance; or a status and
        a reason when there is nothing to believe in.
    """
    matches = stack(
        source.scan,
        target.scan,
        [kind.correspond(source.scan, target.scan) for kind in KINDS],
        config.matching.max_correspondences,
    )
    proposals = _propose(source, target, matches, config)
    if len(proposals.poses) == 0:
        reason = "no consistent set of correspondences and no Manhattan frame in both scans"
        return PairResult(*indices, PairStatus.NO_CORRESPONDENCES, (), reason)
    refined = _refine(source.scan, target.scan, proposals.poses, matches, config)
    candidates = _weigh(source, target, proposals, refined, matches, model or shipped_model())
    candidates = _different(candidates, config)[: config.matching.top_k]
    ranked = tuple(replace(c, rank=i) for i, c in enumerate(candidates))
    if ranked[0].probability < MIN_BELIEVABLE:
        reason = f"the best candidate has probability {ranked[0].probability:.2f}"
        return PairResult(*indices, PairStatus.NOTHING_BELIEVABLE, ranked, reason)
    return PairResult(*indices, PairStatus.OK, ranked)


def _propose(
    source: PreparedScan, target: PreparedScan, matches: CandidateMatches, config: Config
) -> _Proposals:
    spectral = top_poses(matches, consistency_matrix(matches), config.matching.top_k)
    poses = [h.target_T_source for h in spectral]
    scores = [h.score for h in spectral]
    origins = [CandidateOrigin.SPECTRAL] * len(poses)
    strongest = max((len(h.inliers) for h in spectral), default=0)
    if config.matching.manhattan and strongest < CERTAIN_INLIERS:
        for pose, score in manhattan_poses(
            source.raster, target.raster, source.scan.levelling, target.scan.levelling
        ):
            poses.append(pose)
            scores.append(score)
            origins.append(CandidateOrigin.MANHATTAN)
    return _Proposals(np.array(poses).reshape(-1, 4, 4), tuple(origins), np.array(scores))


def _refine(
    source: CompletedScan,
    target: CompletedScan,
    poses: Array,
    matches: CandidateMatches,
    config: Config,
) -> Refined:
    """The local module: relations under the initial poses, then robust regression."""
    relations = PatchRelations().predict(source, target, poses)
    support = _keypoint_support(matches, poses)
    anchors = Matches(
        np.broadcast_to(matches.source, (len(poses), *matches.source.shape)),
        np.broadcast_to(matches.target, (len(poses), *matches.target.shape)),
        support.astype(np.float64),
    )
    return refine(source.surface, target.surface, poses, relations, anchors, config.refinement)


def _keypoint_support(matches: CandidateMatches, poses: Array) -> BoolArray:
    """(K, m) which point correspondences agree with each pose; planes have no fixed point."""
    planes = np.array([k == "planes" for k in matches.kinds])[matches.kind]
    support = [agreeing(matches, pose, SUPPORT_SCALE) & ~planes for pose in poses]
    return np.array(support).reshape(len(poses), len(matches))


def _weigh(
    source: PreparedScan,
    target: PreparedScan,
    proposals: _Proposals,
    refined: Refined,
    matches: CandidateMatches,
    model: ProbabilityModel,
) -> list[PoseCandidate]:
    """Candidates with evidence and probability, most probable first."""
    poses = refined.target_T_source
    support = np.array([agreeing(matches, pose, SUPPORT_SCALE) for pose in poses])
    evidence = _evidence(source, target, proposals, poses, matches, support)
    probability = model.probabilities([e.features for e in evidence])
    return [
        PoseCandidate(
            rank=rank,
            target_T_source=poses[k],
            origin=proposals.origins[k],
            score=float(proposals.scores[k]),
            probability=float(probability[k]),
            evidence=evidence[k],
            covariance=refined.covariance[k],
            matches=_matches_by_kind(matches, support[k]),
        )
        for rank, k in enumerate(np.argsort(-probability, kind="stable"))
    ]


def _evidence(
    source: PreparedScan,
    target: PreparedScan,
    proposals: _Proposals,
    poses: Array,
    matches: CandidateMatches,
    support: BoolArray,
) -> list[Evidence]:
    inverse = se3.inverse(poses)
    overlap, residual = surface_agreement(
        source.scan.surface, target.scan.surface, (source.tree, target.tree), poses
    )
    seen_t = visible_agreement(
        target.scan, se3.transform(poses, _thin(source)), target.depth_min, target.depth_max
    )
    seen_s = visible_agreement(
        source.scan, se3.transform(inverse, _thin(target)), source.depth_min, source.depth_max
    )
    count = seen_t[0] + seen_s[0]
    total = np.maximum(count, 1)
    on_surface = (seen_t[0] * seen_t[1] + seen_s[0] * seen_s[1]) / total
    violation = (seen_t[0] * seen_t[2] + seen_s[0] * seen_s[2]) / total
    tilt, floor_gap = gravity_disagreement(source.scan.levelling, target.scan.levelling, poses)
    yaw = yaw_disagreement(source.scan.levelling, target.scan.levelling, poses)
    per_kind = {k: _unique_support(matches, support, i) for i, k in enumerate(matches.kinds)}
    points = sum(per_kind[k] for k in per_kind if k != "planes")
    spread = np.array([_spread(matches.source[s]) for s in support])
    rest = _best_other(np.log1p(points))
    out = []
    for k, origin in enumerate(proposals.origins):
        manhattan = origin is CandidateOrigin.MANHATTAN
        features = {
            "xfeat": float(np.log1p(per_kind["xfeat"][k])),
            "sift": float(np.log1p(per_kind["sift"][k])),
            "planes": float(np.log1p(per_kind["planes"][k])),
            "share": float(points[k] / (10.0 + len(matches))),
            "lead": float(np.clip(np.log1p(points[k]) - rest[k], -2.0, 2.0)),
            "spread": float(spread[k]),
            "overlap": float(overlap[k]),
            "residual": float(residual[k]),
            "visible": float(np.log1p(count[k])),
            "on_surface": float(on_surface[k]),
            "violation": float(np.sqrt(violation[k])),
            "tilt": float(min(tilt[k], 0.35)),
            "floor_gap": float(min(floor_gap[k], 0.5)),
            "yaw": float(yaw[k]),
            "manhattan": float(manhattan),
            "raster": float(proposals.scores[k]) / 100.0 if manhattan else 0.0,
        }
        counts = dict.fromkeys(Representation, 0)
        for kind in KINDS:
            counts[kind.representation] += int(per_kind[kind.name][k])
        out.append(
            Evidence(float(residual[k]), float(overlap[k]), float(violation[k]), counts, features)
        )
    return out


def _thin(prepared: PreparedScan, count: int = 1000) -> Array:
    points = prepared.scan.surface.points
    return points[:: max(1, len(points) // count)]


def _unique_support(matches: CandidateMatches, support: BoolArray, kind: int) -> IntArray:
    """(K,) number of different source features of a kind among the supporting correspondences."""
    own = matches.kind == kind
    return np.array([len(np.unique(matches.indices[s & own, 0])) for s in support])


def _spread(points: Array) -> float:
    """How well points pin down a rotation: their second largest standard deviation, metres."""
    if len(points) < 3:
        return 0.0
    return float(np.sqrt(max(np.linalg.eigvalsh(np.cov(points.T))[1], 0.0)))


def _best_other(values: Array) -> Array:
    """For each entry the largest of the others, 0 when alone."""
    return np.array([np.delete(values, k).max(initial=0.0) for k in range(len(values))])


def _matches_by_kind(matches: CandidateMatches, support: BoolArray) -> dict[str, IntArray]:
    return {
        name: matches.indices[support & (matches.kind == i)] for i, name in enumerate(matches.kinds)
    }


def _different(candidates: list[PoseCandidate], config: Config) -> list[PoseCandidate]:
    """Drop near-duplicates; a kept candidate inherits the probability of those it stands for."""
    kept: list[PoseCandidate] = []
    angle = np.radians(config.matching.duplicate_angle_deg)
    for candidate in candidates:
        for i, other in enumerate(kept):
            turn, shift = se3.distance(candidate.target_T_source, other.target_T_source)
            if turn < angle and shift < config.matching.duplicate_distance_m:
                total = min(other.probability + candidate.probability, 1.0)
                kept[i] = replace(other, probability=total)
                break
        else:
            kept.append(candidate)
    return sorted(kept, key=lambda c: -c.probability)
