"""Top-K consistent correspondence sets by leading eigenvectors (Leordeanu and Hebert 2005).

Each round takes the leading eigenvector of the consistency matrix, rounds it greedily to a
one-to-one set whose members agree with each other, fits a rigid motion, and deflates: all
correspondences that the motion explains leave the matrix. The eigenvectors of the deflated
matrices stay non-negative and each answer differs from those before. Motions between levelled
scans keep the vertical: the up directions enter the fit as normals of overwhelming weight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from fewview.geometry import se3
from fewview.matching.consistency import CandidateMatches
from fewview.matching.rigid import fit_rigid
from fewview.types import Array, BoolArray, IntArray

MIN_SET = 3
ROUNDS_PER_POSE = 2
MIN_RELATIVE_SCORE = 0.005
MIN_AGREEMENT = 0.5
MAX_POWER_ITERATIONS = 30
REFITS = 3
INLIER_SCALE = 2.0
MAX_NORMAL_COS = np.cos(np.radians(45.0))
LEVEL_WEIGHT = 1e4


@dataclass(frozen=True)
class PoseHypothesis:
    """A pose with the correspondences that agree with it.

    Attributes:
        target_T_source: (4, 4).
        score: u^T C u of the normalised indicator of its set, the strength of the agreement.
        inliers: (n,) indices into the candidate matches.
    """

    target_T_source: Array
    score: float
    inliers: IntArray


def top_poses(
    matches: CandidateMatches, consistency: sparse.csr_matrix, count: int
) -> list[PoseHypothesis]:
    """Up to ``count`` poses from the strongest consistent sets, strongest first; sets that are
    hopeless beside the strongest are not followed up."""
    alive = np.ones(len(matches), dtype=bool)
    poses: list[PoseHypothesis] = []
    for _ in range(ROUNDS_PER_POSE * count):
        vector = leading_eigenvector(consistency, alive)
        chosen = round_greedily(vector, consistency, matches)
        if len(chosen) < MIN_SET:
            break
        hypothesis = _fit(matches, consistency, chosen)
        if poses and hypothesis.score < MIN_RELATIVE_SCORE * poses[0].score:
            break
        explained = agreeing(matches, hypothesis.target_T_source, INLIER_SCALE)
        alive &= ~explained
        alive[chosen] = False
        if len(hypothesis.inliers) >= MIN_SET:
            poses.append(hypothesis)
        if len(poses) == count:
            break
    return poses


def leading_eigenvector(matrix: sparse.csr_matrix, alive: BoolArray) -> Array:
    """The leading eigenvector of the matrix restricted to ``alive``, non-negative, unit length."""
    mask = alive.astype(matrix.dtype)
    vector = mask * np.asarray(matrix @ mask)
    for _ in range(MAX_POWER_ITERATIONS):
        norm = np.linalg.norm(vector)
        if norm < 1e-12:
            return np.zeros_like(vector)
        vector = vector / norm
        following = mask * np.asarray(matrix @ vector)
        if np.linalg.norm(following - (following @ vector) * vector) < 1e-4 * norm:
            break
        vector = following
    norm = np.linalg.norm(vector)
    return np.asarray(vector / norm if norm > 0 else vector)


def round_greedily(vector: Array, matrix: sparse.csr_matrix, matches: CandidateMatches) -> IntArray:
    """Indices of a consistent one-to-one set: in falling order of the eigenvector, one joins when
    it agrees with at least half of those chosen and shares no feature with them."""
    order = np.argsort(-vector, kind="stable")
    order = order[vector[order] > 1e-3 * max(float(vector.max(initial=0.0)), 1e-12)]
    agreements = np.zeros(len(vector))
    used: set[tuple[int, int, int]] = set()
    chosen: list[int] = []
    for c in order:
        kind, (a, b) = int(matches.kind[c]), matches.indices[c]
        keys = ((kind, 0, int(a)), (kind, 1, int(b)))
        if agreements[c] < MIN_AGREEMENT * len(chosen) or any(k in used for k in keys):
            continue
        chosen.append(int(c))
        used.update(keys)
        agreements[matrix.indices[matrix.indptr[c] : matrix.indptr[c + 1]]] += 1.0
    return np.array(chosen, dtype=np.int64)


def agreeing(matches: CandidateMatches, target_T_source: Array, scale: float) -> BoolArray:
    """Which correspondences a pose explains: distance within ``scale`` times the kind's length
    scale and normals, where known, within 45 degrees."""
    moved = se3.transform(target_T_source, matches.source)
    turned = se3.rotate(target_T_source, matches.source_normals)
    distance = np.linalg.norm(moved - matches.target, axis=1)
    cosine = (turned * matches.target_normals).sum(axis=1)
    near = distance < scale * matches.scale("length_m")
    return np.asarray(near & ((cosine > MAX_NORMAL_COS) | ~matches.normals_known))


def _fit(matches: CandidateMatches, matrix: sparse.csr_matrix, chosen: IntArray) -> PoseHypothesis:
    score = float(matrix[chosen][:, chosen].sum()) / len(chosen)
    target_T_source = _fit_to(matches, chosen)
    inliers = chosen
    for _ in range(REFITS):
        inliers = np.flatnonzero(agreeing(matches, target_T_source, INLIER_SCALE))
        if len(inliers) < MIN_SET:
            break
        target_T_source = _fit_to(matches, inliers)
    return PoseHypothesis(target_T_source, score, inliers)


def _fit_to(matches: CandidateMatches, members: IntArray) -> Array:
    precision = (0.05 / matches.scale("length_m")[members].astype(np.float64)) ** 2
    weights = matches.similarity[members].astype(np.float64) * precision
    source_normals, target_normals = (
        matches.source_normals[members],
        matches.target_normals[members],
    )
    normal_weights = weights * matches.scale("normal_weight")[members]
    if matches.up is not None:
        source_normals = np.vstack([source_normals, matches.up[0]])
        target_normals = np.vstack([target_normals, matches.up[1]])
        normal_weights = np.append(normal_weights, LEVEL_WEIGHT * weights.sum())
    return fit_rigid(
        matches.source[members],
        matches.target[members],
        weights,
        source_normals,
        target_normals,
        normal_weights,
    )
