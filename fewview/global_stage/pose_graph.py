"""Robust pose graph of one component; the only module that uses GTSAM.

One between-factor per selected candidate, one prior on the first scan or on every scan whose pose
the user fixed. The loss is Huber's, then Cauchy's from where that ended: on simulated graphs with
0 to 40 % mild outliers and misjudged covariances the pair was at least as accurate as graduated
non-convexity (GNC, TLS and Geman-McClure) and, unlike it, never leaves a scan without a factor.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from fewview.geometry import se3
from fewview.types import Array, CandidateOrigin, EdgeReport, PoseCandidate

FLOOR_SIGMA = np.array([math.radians(0.5)] * 3 + [0.01] * 3)
"""Standard deviation (rad, m) of a candidate whose surfaces overlap completely, at the least."""

CEILING_SIGMA = np.array([math.radians(30.0)] * 3 + [1.0] * 3)
"""A direction that refinement left open counts as known to this, not as unknown."""

HESSIAN_INFLATION = 4.0
"""Point-to-plane Hessians take neighbouring points for independent: variances times this."""

LEAST_OVERLAP = 0.1
"""Overlap below this lowers the weight no further."""

HUBER_SCALE = 1.345
"""Whitened residual at which Huber's loss turns linear (95 % efficiency)."""

CAUCHY_SCALE = 3.0
"""Whitened residual at which Cauchy's loss halves a factor's weight."""

PRIOR_SIGMA = 1e-4
"""Standard deviation (rad, m) of the pose of the first scan, or of a fixed one."""

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Edge:
    """A selected candidate of a pair."""

    source: int
    target: int
    candidate: PoseCandidate


@dataclass(frozen=True)
class Optimised:
    """A component after the pose graph.

    Attributes:
        pose: scan index -> (4, 4) frame_T_scan.
        edges: report of every edge, in the order given.
        improved: False when the input was the better one and was kept.
    """

    pose: Mapping[int, Array]
    edges: tuple[EdgeReport, ...]
    improved: bool


def optimise(
    initial: Mapping[int, Array], edges: Sequence[Edge], fixed: Collection[int] = ()
) -> Optimised:
    """Refine the poses of one connected component.

    Args:
        initial: scan index -> (4, 4) frame_T_scan from the discrete stage.
        edges: selected candidates; together they connect all scans of ``initial``.
        fixed: scans that stay where they are; the first one when there are none.

    Returns:
        Poses in the same frame whose robust total error is not above that of ``initial``.
    """
    start = gtsam.Values()
    for scan, frame_T_scan in initial.items():
        start.insert(scan, gtsam.Pose3(frame_T_scan))
    cauchy = gtsam.noiseModel.mEstimator.Cauchy.Create(CAUCHY_SCALE)
    anchors = {scan: initial[scan] for scan in sorted(fixed) or [min(initial)]}
    graph = _graph(anchors, edges, cauchy)
    huber = _graph(anchors, edges, gtsam.noiseModel.mEstimator.Huber.Create(HUBER_SCALE))
    end = gtsam.LevenbergMarquardtOptimizer(huber, start).optimize()
    end = gtsam.LevenbergMarquardtOptimizer(graph, end).optimize()
    improved = bool(graph.error(end) <= graph.error(start))
    if not improved:
        _LOG.warning(
            "pose graph of %d scans kept its input: optimising made it worse", len(initial)
        )
    pose = {scan: _matrix(end.atPose3(scan)) if improved else initial[scan] for scan in initial}
    weights = [cauchy.weight(_whitened_norm(edge, pose)) for edge in edges]
    reports = [
        _report(edge, weight, initial, pose) for edge, weight in zip(edges, weights, strict=True)
    ]
    return Optimised(pose, tuple(reports), improved)


def covariance(candidate: PoseCandidate) -> Array:
    """(6, 6) covariance of a factor, rotation first: refinement's, inflated and conditioned.

    Its floor grows as the overlap shrinks, its standard deviations end at `CEILING_SIGMA`. That of
    a given pose is as it stands.
    """
    if candidate.origin is CandidateOrigin.GIVEN:
        return candidate.covariance
    overlap = min(max(candidate.evidence.overlap, LEAST_OVERLAP), 1.0)
    floor = np.square(FLOOR_SIGMA / overlap)
    scaled = HESSIAN_INFLATION * candidate.covariance / np.outer(CEILING_SIGMA, CEILING_SIGMA)
    usable = scaled if np.all(np.isfinite(scaled)) else np.eye(6)
    values, vectors = np.linalg.eigh(0.5 * (usable + usable.T))
    bounded = (vectors * np.clip(values, 0.0, 1.0)) @ vectors.T
    return np.asarray(bounded * np.outer(CEILING_SIGMA, CEILING_SIGMA) + np.diag(floor))


def _graph(
    anchors: Mapping[int, Array], edges: Sequence[Edge], loss: gtsam.noiseModel.mEstimator.Base
) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    tight = gtsam.noiseModel.Isotropic.Sigma(6, PRIOR_SIGMA)
    for scan, pose in anchors.items():
        graph.add(gtsam.PriorFactorPose3(scan, gtsam.Pose3(pose), tight))
    for edge in edges:
        gaussian = gtsam.noiseModel.Gaussian.Covariance(covariance(edge.candidate))
        noise = gtsam.noiseModel.Robust.Create(loss, gaussian)
        motion = gtsam.Pose3(edge.candidate.target_T_source)
        graph.add(gtsam.BetweenFactorPose3(edge.target, edge.source, motion, noise))
    return graph


def _whitened_norm(edge: Edge, pose: Mapping[int, Array]) -> float:
    """Mahalanobis length of the edge's error."""
    asked = gtsam.Pose3(edge.candidate.target_T_source)
    found = gtsam.Pose3(se3.inverse(pose[edge.target]) @ pose[edge.source])
    error = asked.localCoordinates(found)
    return float(np.sqrt(error @ np.linalg.solve(covariance(edge.candidate), error)))


def _report(
    edge: Edge, weight: float, before: Mapping[int, Array], after: Mapping[int, Array]
) -> EdgeReport:
    before_rad, before_m = _residual(edge, before)
    after_rad, after_m = _residual(edge, after)
    return EdgeReport(
        source=edge.source,
        target=edge.target,
        rank=edge.candidate.rank,
        weight=float(weight),
        before_m=before_m,
        after_m=after_m,
        before_rad=before_rad,
        after_rad=after_rad,
    )


def _residual(edge: Edge, pose: Mapping[int, Array]) -> tuple[float, float]:
    found = se3.inverse(pose[edge.target]) @ pose[edge.source]
    angle, shift = se3.distance(edge.candidate.target_T_source, found)
    return float(angle), float(shift)


def _matrix(pose: gtsam.Pose3) -> Array:
    return se3.pose(se3.nearest_rotation(pose.rotation().matrix()), np.asarray(pose.translation()))
