"""The robust pose graph."""

from __future__ import annotations

import dataclasses

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.planted_graphs import Noise, candidate, room_poses, shaken
from fewview.geometry import se3
from fewview.global_stage.pose_graph import CAUCHY_SCALE, Edge, covariance, optimise
from fewview.types import Array, CandidateOrigin


def ring(poses: Array, noise: Noise, rng: np.random.Generator) -> list[Edge]:
    """Edges between all scans at most two apart on a ring."""
    n = len(poses)
    pairs = sorted({(min(i, j), max(i, j)) for i in range(n) for j in ((i + 1) % n, (i + 2) % n)})
    truth = {(s, t): se3.inverse(poses[t]) @ poses[s] for s, t in pairs if s != t}
    return [
        Edge(s, t, candidate(0, shaken(rng, m, noise), 0.9, 0.5)) for (s, t), m in truth.items()
    ]


def chained(edges: list[Edge], first: Array, scans: int) -> dict[int, Array]:
    pose = {0: first}
    while len(pose) < scans:
        for edge in edges:
            if edge.target in pose and edge.source not in pose:
                pose[edge.source] = pose[edge.target] @ edge.candidate.target_T_source
            elif edge.source in pose and edge.target not in pose:
                back = se3.inverse(edge.candidate.target_T_source)
                pose[edge.target] = pose[edge.source] @ back
    return pose


def mean_shift(found: dict[int, Array], truth: Array) -> float:
    return float(np.mean([np.linalg.norm(found[i][:3, 3] - truth[i][:3, 3]) for i in found]))


def robust_total(edges: list[Edge], pose: dict[int, Array]) -> float:
    """Cauchy's loss of the whitened errors, in small-angle form."""
    total = 0.0
    for edge in edges:
        asked = edge.candidate.target_T_source
        error = se3.inverse(asked) @ se3.inverse(pose[edge.target]) @ pose[edge.source]
        xi = np.concatenate([se3.rotation_log(error[:3, :3]), error[:3, 3]])
        squared = xi @ np.linalg.solve(covariance(edge.candidate), xi)
        total += 0.5 * CAUCHY_SCALE**2 * np.log1p(squared / CAUCHY_SCALE**2)
    return total


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 7), st.floats(0.0, 1.0))
def test_optimising_is_never_worse(seed: int, scans: int, roughness: float) -> None:
    rng = np.random.default_rng(seed)
    poses = room_poses(rng, scans)
    edges = ring(poses, Noise(60.0 * roughness, 2.0 * roughness), rng)
    start = chained(edges, poses[0], scans)
    result = optimise(start, edges)
    before, after = robust_total(edges, start), robust_total(edges, dict(result.pose))
    assert after <= before * 1.05 + 1e-6
    assert set(result.pose) == set(start)


def test_noise_is_averaged_and_the_first_scan_stays() -> None:
    rng = np.random.default_rng(0)
    poses = room_poses(rng, 8)
    edges = ring(poses, Noise(3.0, 0.05), rng)
    start = chained(edges, poses[0], 8)
    result = optimise(start, edges)
    assert mean_shift(dict(result.pose), poses) < 0.7 * mean_shift(start, poses)
    np.testing.assert_allclose(result.pose[0], poses[0], atol=1e-3)


def test_an_outlier_loses_its_weight() -> None:
    rng = np.random.default_rng(1)
    poses = room_poses(rng, 6)
    edges = ring(poses, Noise(1.0, 0.02), rng)
    start = chained(edges, poses[0], 6)
    bad = 4
    wrong = edges[bad].candidate.target_T_source @ se3.exp(np.array([0, 0.3, 0, 0.5, 0, 0]))
    edges[bad] = Edge(edges[bad].source, edges[bad].target, candidate(0, wrong, 0.9, 0.5))
    result = optimise(start, edges)
    weights = [edge.weight for edge in result.edges]
    assert np.argmin(weights) == bad
    assert weights[bad] < 0.3
    assert np.delete(weights, bad).min() > 0.6
    assert result.edges[bad].after_m > 0.4
    assert mean_shift(dict(result.pose), poses) < 0.05


def test_fixed_scans_stay_and_the_others_follow() -> None:
    rng = np.random.default_rng(3)
    poses = room_poses(rng, 6)
    edges = ring(poses, Noise(3.0, 0.05), rng)
    start = chained(edges, poses[0], 6) | {2: poses[2], 4: poses[4]}
    result = optimise(start, edges, fixed=(2, 4))
    for scan in (2, 4):
        np.testing.assert_allclose(result.pose[scan], poses[scan], atol=1e-3)
    assert mean_shift(dict(result.pose), poses) < 0.7 * mean_shift(start, poses)


def test_a_given_relative_pose_is_met_against_all_others() -> None:
    rng = np.random.default_rng(4)
    poses = room_poses(rng, 6)
    edges = ring(poses, Noise(1.0, 0.02), rng)
    off = edges[0].candidate.target_T_source @ se3.exp(np.array([0, 0.1, 0, 0.3, 0, 0]))
    given = dataclasses.replace(
        candidate(0, off, 1.0), origin=CandidateOrigin.GIVEN, covariance=1e-6 * np.eye(6)
    )
    start = chained(edges, poses[0], 6)
    report = optimise(start, [Edge(edges[0].source, edges[0].target, given), *edges[1:]]).edges[0]
    assert report.before_m > 0.25
    assert report.after_m < 3e-3 and report.after_rad < 3e-3


def test_a_tree_is_left_as_it_is() -> None:
    poses = room_poses(np.random.default_rng(2), 3)
    edges = [
        Edge(s, t, candidate(0, se3.inverse(poses[t]) @ poses[s], 0.9)) for s, t in ((0, 1), (1, 2))
    ]
    result = optimise(dict(enumerate(poses)), edges)
    for i in range(3):
        np.testing.assert_allclose(result.pose[i], poses[i], atol=1e-6)
    assert all(edge.weight > 0.999 and edge.after_m < 1e-6 for edge in result.edges)


def test_covariances_are_conditioned() -> None:
    sure = candidate(0, np.eye(4), 0.9, overlap=1.0)
    flawless = dataclasses.replace(sure, covariance=np.zeros((6, 6)))
    np.testing.assert_allclose(
        np.sqrt(np.diag(covariance(flawless))), [np.radians(0.5)] * 3 + [0.01] * 3
    )
    for raw in (np.full((6, 6), np.nan), 1e12 * np.eye(6), np.diag([1e-9] * 5 + [1e9])):
        factor = covariance(dataclasses.replace(sure, covariance=raw))
        values = np.linalg.eigvalsh(factor)
        assert values.min() > 0.0
        assert values.max() < 1.1


def test_less_overlap_means_less_weight() -> None:
    near, far = (candidate(0, np.eye(4), 0.9, overlap) for overlap in (0.8, 0.1))
    assert np.all(np.diag(covariance(far)) > np.diag(covariance(near)))
