"""Planted problems for the consistency matrix, the spectral sets and the rigid fit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fewview.completion.xfeat import SCALES
from fewview.geometry import se3
from fewview.matching.consistency import CandidateMatches, consistency_matrix
from fewview.matching.rigid import fit_rigid
from fewview.matching.spectral import leading_eigenvector, top_poses


def unit(rng: np.random.Generator, count: int) -> np.ndarray:
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def planted(
    rng: np.random.Generator, poses: list[np.ndarray], each: list[int], outliers: int
) -> CandidateMatches:
    """Matches that agree with each of several poses, and outliers that agree with none."""
    source, normals, target, target_normals = [], [], [], []
    for pose, count in zip(poses, each, strict=True):
        p, n = rng.uniform(-2, 2, (count, 3)), unit(rng, count)
        source.append(p)
        normals.append(n)
        target.append(se3.transform(pose, p) + rng.normal(scale=0.005, size=p.shape))
        target_normals.append(se3.rotate(pose, n))
    source.append(rng.uniform(-2, 2, (outliers, 3)))
    target.append(rng.uniform(-2, 2, (outliers, 3)))
    normals.append(unit(rng, outliers))
    target_normals.append(unit(rng, outliers))
    total = sum(each) + outliers
    indices = np.stack([np.arange(total), np.arange(total)], axis=1)
    return CandidateMatches(
        np.concatenate(source),
        np.concatenate(target),
        np.concatenate(normals),
        np.concatenate(target_normals),
        np.full(total, 0.9, dtype=np.float32),
        {"xfeat": SCALES},
        np.zeros(total, dtype=np.int64),
        indices,
    )


def dense_consistency(m: CandidateMatches) -> np.ndarray:
    """The supplementary's formula written out pair by pair."""
    gammas = (
        SCALES.length_m,
        SCALES.normal_angle,
        SCALES.direction_angle,
        SCALES.direction_angle,
    )
    size = len(m)
    out = np.zeros((size, size))

    def quantities(p: np.ndarray, n: np.ndarray, i: int, j: int) -> np.ndarray:
        length = np.linalg.norm(p[i] - p[j])
        direction = (p[i] - p[j]) / length
        cosines = [n[i] @ n[j], n[i] @ direction, n[j] @ direction]
        return np.array([length, *np.arccos(np.clip(cosines, -1, 1))])

    for i in range(size):
        for j in range(i + 1, size):
            a = quantities(m.source, m.source_normals, i, j)
            b = quantities(m.target, m.target_normals, i, j)
            value = np.exp(-sum((a - b) ** 2 / (2 * np.array(gammas) ** 2)))
            if value > 0.1 and min(a[0], b[0]) > 0.05:
                out[i, j] = out[j, i] = value * m.similarity[i] * m.similarity[j]
    return out


def test_matrix_is_the_supplementarys_formula() -> None:
    rng = np.random.default_rng(0)
    matches = planted(rng, [se3.exp(rng.normal(size=6))], [20], 15)
    np.testing.assert_allclose(
        consistency_matrix(matches).toarray(), dense_consistency(matches), atol=2e-3
    )


def test_matrix_does_not_depend_on_the_block_size(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    matches = planted(rng, [se3.exp(rng.normal(size=6))], [30], 30)
    whole = consistency_matrix(matches).toarray()
    monkeypatch.setattr("fewview.matching.consistency.BLOCK", 7)
    np.testing.assert_allclose(consistency_matrix(matches).toarray(), whole, atol=1e-6)


def test_matches_that_share_a_feature_do_not_support_each_other() -> None:
    rng = np.random.default_rng(2)
    matches = planted(rng, [np.eye(4)], [12], 0)
    matches.indices[3, 0] = matches.indices[4, 0]
    matrix = consistency_matrix(matches).toarray()
    assert matrix[3, 4] == 0.0
    assert matrix[3, 5] > 0.0


def test_leading_eigenvector_is_that_of_the_dense_matrix() -> None:
    rng = np.random.default_rng(3)
    matches = planted(rng, [se3.exp(rng.normal(size=6))], [25], 25)
    matrix = consistency_matrix(matches)
    vector = leading_eigenvector(matrix, np.ones(len(matches), dtype=bool))
    exact = np.linalg.eigh(matrix.toarray())[1][:, -1]
    assert abs(vector @ exact) > 0.999


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000))
def test_planted_poses_are_found_in_order_of_their_support(seed: int) -> None:
    rng = np.random.default_rng(seed)
    poses = [se3.exp(np.append(rng.uniform(-1.5, 1.5, 3), rng.uniform(-2, 2, 3))) for _ in range(2)]
    turn, _ = se3.distance(poses[0], poses[1])
    if np.degrees(turn) < 25:
        return
    matches = planted(rng, poses, [40, 20], 60)
    found = top_poses(matches, consistency_matrix(matches), 5)
    for truth, hypothesis in zip(poses, found, strict=False):
        angle, shift = se3.distance(hypothesis.target_T_source, truth)
        assert np.degrees(angle) < 2.0 and shift < 0.05
    scores = [h.score for h in found[:2]]
    assert scores[0] > scores[1]


def test_no_pose_from_outliers_alone_has_a_strong_score() -> None:
    rng = np.random.default_rng(5)
    outliers = planted(rng, [], [], 80)
    signal = planted(rng, [se3.exp(rng.normal(size=6))], [30], 50)
    best_outlier = max(
        (h.score for h in top_poses(outliers, consistency_matrix(outliers), 3)), default=0.0
    )
    best = top_poses(signal, consistency_matrix(signal), 1)[0].score
    assert best > 3 * best_outlier


def test_empty_problem_gives_no_pose() -> None:
    nothing = planted(np.random.default_rng(0), [], [], 0)
    assert top_poses(nothing, consistency_matrix(nothing), 5) == []


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_rigid_fit_recovers_a_motion(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = se3.exp(rng.uniform(-1.5, 1.5, 6))
    p, n = rng.normal(size=(8, 3)), unit(rng, 8)
    found = fit_rigid(
        p,
        se3.transform(truth, p),
        rng.uniform(0.1, 1, 8),
        n,
        se3.rotate(truth, n),
        np.full(8, 0.02),
    )
    np.testing.assert_allclose(found, truth, atol=1e-8)


def test_rigid_fit_ignores_matches_without_weight() -> None:
    rng = np.random.default_rng(7)
    p = rng.normal(size=(6, 3))
    q = p + np.array([0.5, 0.0, 0.0])
    q[0] += 10.0
    weights = np.array([0.0, 1, 1, 1, 1, 1])
    found = fit_rigid(p, q, weights, unit(rng, 6), unit(rng, 6), np.zeros(6))
    np.testing.assert_allclose(found[:3, 3], [0.5, 0.0, 0.0], atol=1e-9)
