"""Pair results of scans with known poses, their probabilities true by construction."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fewview.geometry import se3
from fewview.types import (
    Array,
    CandidateOrigin,
    Evidence,
    Levelling,
    PairResult,
    PairStatus,
    PoseCandidate,
)

UP_IN_CAMERA = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""level_R_scan of a camera that looks horizontally."""


@dataclass(frozen=True)
class Noise:
    """Standard deviations of right candidates."""

    angle_deg: float = 2.0
    distance_m: float = 0.05


def room_poses(rng: np.random.Generator, count: int) -> Array:
    """(count, 4, 4) world_T_scan: upright cameras at any heading in a room, world z up."""
    heading = rng.uniform(-np.pi, np.pi, count)
    tilt = np.stack([rng.normal(0.0, 0.2, count), np.zeros(count), np.zeros(count)], axis=-1)
    turn = se3.rotation_exp(np.stack([0 * heading, 0 * heading, heading], axis=-1))
    place = np.stack([*rng.uniform(-2.5, 2.5, (2, count)), rng.uniform(1.0, 1.8, count)], axis=-1)
    return se3.pose(turn @ UP_IN_CAMERA.T @ se3.rotation_exp(tilt), place)


def candidate(
    rank: int, target_T_source: Array, probability: float, overlap: float = 0.0
) -> PoseCandidate:
    """A candidate with plausible evidence."""
    covariance = np.diag([1e-4] * 3 + [4e-4] * 3)
    evidence = Evidence(0.02, overlap, 0.0, {})
    origin = CandidateOrigin.SPECTRAL
    return PoseCandidate(rank, target_T_source, origin, 1.0, probability, evidence, covariance)


def pair_result(source: int, target: int, candidates: Sequence[PoseCandidate]) -> PairResult:
    """A pair with these candidates, or without any."""
    status = PairStatus.OK if candidates else PairStatus.NO_CORRESPONDENCES
    return PairResult(source, target, status, tuple(candidates))


def shaken(rng: np.random.Generator, motion: Array, noise: Noise) -> Array:
    """``motion`` with Gaussian noise."""
    sigma = np.array([np.radians(noise.angle_deg)] * 3 + [noise.distance_m] * 3)
    return np.asarray(motion @ se3.exp(rng.normal(size=6) * sigma / np.sqrt(3.0)))


def planted_pair(
    rng: np.random.Generator,
    world_T_scan: Array,
    source: int,
    target: int,
    probabilities: Array,
    noise: Noise,
    mirage: Array | None = None,
) -> PairResult:
    """Candidates of given probabilities: at most one is right, drawn by those probabilities.

    Args:
        rng: random numbers.
        world_T_scan: (n, 4, 4) the truth.
        source, target: the scans.
        probabilities: of the candidates.
        noise: of all candidates.
        mirage: (n, 4, 4) false poses, from which the most probable wrong candidate comes.
    """
    right = rng.choice(
        len(probabilities) + 1, p=[*probabilities, max(1.0 - probabilities.sum(), 0.0)]
    )
    wrong = room_poses(rng, 2 * len(probabilities))
    motions = se3.inverse(wrong[::2]) @ wrong[1::2]
    if right < len(probabilities):
        motions[right] = se3.inverse(world_T_scan[target]) @ world_T_scan[source]
    wrong_ranks = np.flatnonzero(np.arange(len(probabilities)) != right)
    if mirage is not None and len(wrong_ranks):
        motions[wrong_ranks[0]] = se3.inverse(mirage[target]) @ mirage[source]
    made = [
        candidate(rank, shaken(rng, motion, noise), float(probability))
        for rank, (motion, probability) in enumerate(zip(motions, probabilities, strict=True))
    ]
    return pair_result(source, target, made)


def planted_graph(
    seed: int,
    scans: int,
    top_k: int,
    link_rate: float = 0.5,
    strength: tuple[float, float] = (0.1, 0.9),
    noise: Noise | None = None,
    lookalike: float = 0.0,
) -> tuple[Array, list[PairResult]]:
    """Poses of a random scene and the results of all pairs.

    Args:
        seed: of everything.
        scans: number of scans.
        top_k: candidates a pair.
        link_rate: share of pairs whose candidates carry the probability ``strength`` in sum;
            the others carry a tenth of it.
        strength: range of the summed probability of a pair.
        noise: of right candidates.
        lookalike: share of the pairs between the first half of the scans and the others in which
            a wrong candidate agrees with those of other such pairs: it takes the first half for
            the same part of the room seen from the other side.
    """
    rng = np.random.default_rng(seed)
    poses = room_poses(rng, scans)
    mirage = poses.copy()
    mirage[: scans // 2] = np.diag([-1.0, -1.0, 1.0, 1.0]) @ mirage[: scans // 2]
    pairs = []
    for source, target in itertools.combinations(range(scans), 2):
        total = rng.uniform(*strength) * (1.0 if rng.uniform() < link_rate else 0.1)
        shares = total * np.sort(rng.dirichlet(np.full(top_k, 0.5)))[::-1]
        fooled = (source < scans // 2 <= target) and rng.uniform() < lookalike
        false = mirage if fooled else None
        pairs.append(planted_pair(rng, poses, source, target, shares, noise or Noise(), false))
    return poses, pairs


def upright_levelling(world_T_scan: Array, confidence: float = 0.8) -> Levelling:
    """The true levelling of a scan in a z-up world with the floor at 0."""
    return Levelling(world_T_scan[:3, :3].copy(), confidence, False, -float(world_T_scan[2, 3]))
