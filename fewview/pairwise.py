"""One pair of completed scans to its K relative poses, each with evidence and a probability."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fewview.alignment import NEVER, Alignment
from fewview.choice import chosen
from fewview.completion import OBSERVED_KINDS, chosen_kinds
from fewview.config import Config
from fewview.geometry import se3
from fewview.matching.completed import completion_poses
from fewview.matching.consistency import CandidateMatches, consistency_matrix, joined, stack
from fewview.matching.heights import lift, lifted
from fewview.matching.manhattan import manhattan_poses
from fewview.matching.prepared import PreparedScan, aligned
from fewview.matching.spectral import agreeing, top_poses
from fewview.probability import ProbabilityModel, shipped_model
from fewview.refinement import evidence
from fewview.refinement.local import refine_related
from fewview.refinement.regression import Matches, Refined
from fewview.types import (
    Array,
    BoolArray,
    CandidateOrigin,
    CompletedScan,
    Correspondences,
    Evidence,
    IntArray,
    PairResult,
    PairStatus,
    PoseCandidate,
)

CERTAIN_INLIERS = 40
MIN_BELIEVABLE = 0.05
SUPPORT_SCALE = 2.0
ALIGNED = 6


@dataclass(frozen=True)
class Weighed:
    """Different refined poses of a pair with their evidence.

    Attributes:
        poses: (K, 4, 4) target_T_source; covariance: (K, 6, 6).
        origins, scores: where each came from and its score there.
        support: (K, m) which of `matches` agree.
        evidence: one per pose.
    """

    poses: Array
    covariance: Array
    origins: tuple[CandidateOrigin, ...]
    scores: Array
    matches: CandidateMatches
    support: BoolArray
    evidence: list[Evidence]


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
        model: probability model; the shipped one for such scans when not given.

    Returns:
        candidates by falling worth (see `choice`), no two within the duplicate tolerance; or a
        status and a reason when there is nothing to believe in.
    """
    weighed = weigh_pair(source, target, config)
    if len(weighed.poses) == 0:
        reason = "no consistent set of correspondences and no Manhattan frame in both scans"
        return PairResult(*indices, PairStatus.NO_CORRESPONDENCES, (), reason)
    if model is None:
        model = shipped_model(source.scan.room.completed and target.scan.room.completed)
    probability = model.probabilities([e.features for e in weighed.evidence])
    turn_chance = np.exp([e.features.get("aligner_yaw", NEVER) for e in weighed.evidence])
    order = chosen(probability, weighed.poses, turn_chance, config.matching.top_k)
    candidates = tuple(
        _candidate(weighed, int(k), rank, float(probability[k])) for rank, k in enumerate(order)
    )
    best = float(probability.max())
    if best < MIN_BELIEVABLE:
        reason = f"the best candidate has probability {best:.2f}"
        return PairResult(*indices, PairStatus.NOTHING_BELIEVABLE, candidates, reason)
    return PairResult(*indices, PairStatus.OK, candidates)


def weigh_pair(source: PreparedScan, target: PreparedScan, config: Config) -> Weighed:
    """Propose, refine and weigh poses; what `match_pair` does before it judges."""
    observed, completed = _candidate_matches(source.scan, target.scan, config)
    alignment = aligned(source, target)
    proposals, origins, scores = _propose(source, target, observed, completed, alignment, config)
    matches = joined(observed, completed)
    refined = _refine(source, target, proposals, matches, config)
    poses = refined.target_T_source
    support = _support(matches, poses)
    different = _different(source, target, poses, support[:, : len(observed)], config)
    poses, support = poses[different], support[different]
    kept = tuple(origins[k] for k in different)
    covariance = refined.covariance[different]
    found = evidence.gather(
        source, target, poses, covariance, matches, support, kept, scores[different], alignment
    )
    return Weighed(poses, covariance, kept, scores[different], matches, support, found)


def _candidate_matches(
    source: CompletedScan, target: CompletedScan, config: Config
) -> tuple[CandidateMatches, CandidateMatches]:
    """Between what the scans show, and between the rooms that the networks complete."""
    seen: list[Correspondences] = []
    predicted: list[Correspondences] = []
    for kind in chosen_kinds(config.features):
        found = seen if kind in OBSERVED_KINDS else predicted
        found.append(kind.correspond(source, target))
    limit = config.matching.max_correspondences
    return stack(source, target, seen, limit), stack(source, target, predicted, limit, True)


def _propose(
    source: PreparedScan,
    target: PreparedScan,
    observed: CandidateMatches,
    completed: CandidateMatches,
    alignment: Alignment | None,
    config: Config,
) -> tuple[Array, list[CandidateOrigin], Array]:
    """Initial poses (K, 4, 4), where they come from and their scores (K,)."""
    spectral = top_poses(observed, consistency_matrix(observed), config.matching.top_k)
    found = {CandidateOrigin.SPECTRAL: [(h.target_T_source, h.score) for h in spectral]}
    strongest = max((len(h.inliers) for h in spectral), default=0)
    if strongest < CERTAIN_INLIERS:
        source_lift = lift(source.scan, target.scan, source.heights, target.heights)
        found[CandidateOrigin.COMPLETION] = completion_poses(
            target.scan, completed, source_lift, config.matching.top_k
        )
        if config.matching.alignment and alignment is not None:
            best = alignment.best(ALIGNED)
            found[CandidateOrigin.ALIGNMENT] = [
                (lifted(pose, target.scan, source_lift), float(mass))
                for pose, mass in zip(best.target_T_source, best.log_mass, strict=True)
            ]
        if config.matching.manhattan:
            found[CandidateOrigin.MANHATTAN] = manhattan_poses(
                source.raster,
                target.raster,
                source.scan.levelling,
                target.scan.levelling,
                source_lift,
            )
    origins = [origin for origin, poses in found.items() for _ in poses]
    poses = [pose for poses in found.values() for pose in poses]
    stacked = np.array([p for p, _ in poses]).reshape(-1, 4, 4)
    return stacked, origins, np.array([score for _, score in poses])


def _refine(
    source: PreparedScan,
    target: PreparedScan,
    poses: Array,
    matches: CandidateMatches,
    config: Config,
) -> Refined:
    """The local module, held by the matched features that agree with each pose."""
    fixed = matches.scale("fixed_point") > 0
    weight = (_support(matches, poses) & fixed).astype(np.float64)
    anchors = Matches(matches.source, matches.target, weight)
    return refine_related(source, target, poses, anchors, config.refinement)


def _support(matches: CandidateMatches, poses: Array) -> BoolArray:
    """(K, m) which correspondences agree with each pose."""
    support = [agreeing(matches, pose, SUPPORT_SCALE) for pose in poses]
    return np.array(support, dtype=bool).reshape(len(poses), len(matches))


def _different(
    source: PreparedScan,
    target: PreparedScan,
    poses: Array,
    support: BoolArray,
    config: Config,
) -> IntArray:
    """Indices of poses that are different answers; of near-duplicates the one that more seen
    features (support) and surface agree with."""
    visible = evidence.visible_agreement(source, target, poses)
    strength = np.log1p(support.sum(axis=1)) + 3.0 * (visible.on_surface - 2.0 * visible.in_front)
    angle = np.radians(config.matching.duplicate_angle_deg)
    kept: list[int] = []
    for k in np.argsort(-strength, kind="stable"):
        turn, shift = se3.distance(poses[kept].reshape(-1, 4, 4), poses[k])
        if not ((turn < angle) & (shift < config.matching.duplicate_distance_m)).any():
            kept.append(int(k))
    return np.array(kept, dtype=np.int64)


def _candidate(weighed: Weighed, k: int, rank: int, probability: float) -> PoseCandidate:
    matches = weighed.matches
    return PoseCandidate(
        rank=rank,
        target_T_source=weighed.poses[k],
        origin=weighed.origins[k],
        score=float(weighed.scores[k]),
        probability=probability,
        evidence=weighed.evidence[k],
        covariance=weighed.covariance[k],
        matches={
            name: matches.indices[weighed.support[k] & (matches.kind == i)]
            for i, name in enumerate(matches.kinds)
        },
    )
