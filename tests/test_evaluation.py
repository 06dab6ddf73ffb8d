"""The yardstick itself: known errors come back, and no world frame changes a score."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree

from fewview.errors import FewviewError
from fewview.evaluation import evaluate_report, text
from fewview.evaluation.calibration import expected_calibration_error, reliability
from fewview.evaluation.gauge import absolute_errors, align
from fewview.evaluation.mesh import mesh_errors, sample_surface
from fewview.evaluation.metrics import (
    best_of_top_k,
    relative,
    rotation_error_deg,
    translation_error_at_m,
    translation_error_m,
    within,
)
from fewview.evaluation.overlap import overlap, overlap_class, overlap_matrix, thin
from fewview.geometry import se3
from fewview.types import Array

SEEDS = st.integers(0, 2**32 - 1)


def random_poses(rng: np.random.Generator, count: int) -> Array:
    xi = rng.normal(size=(count, 6)) * np.array([2.0] * 3 + [3.0] * 3)
    return se3.exp(xi)


def turn(angle_deg: float, axis: Array, shift: Array) -> Array:
    unit = axis / np.linalg.norm(axis)
    return se3.pose(se3.rotation_exp(np.radians(angle_deg) * unit), shift)


def make_report(names: list[str], poses: list[Array | None], **extra: Any) -> dict[str, Any]:
    scans = [
        {
            "name": name,
            "placed": pose is not None,
            "component": None if pose is None else 0,
            "world_T_scan": None if pose is None else pose.tolist(),
            "probability": 0.0 if pose is None else 0.9,
            "reason": "too little overlap" if pose is None else None,
        }
        for name, pose in zip(names, poses, strict=True)
    ]
    return {"scans": scans, "pairs": [], **extra}


@given(SEEDS, st.floats(0.0, 179.9), st.floats(0.0, 5.0))
def test_a_known_error_is_recovered(seed: int, angle: float, shift: float) -> None:
    rng = np.random.default_rng(seed)
    truth = random_poses(rng, 1)[0]
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    wrong = truth @ turn(angle, rng.normal(size=3), np.zeros(3))
    wrong[:3, 3] += shift * direction
    assert rotation_error_deg(truth, wrong) == pytest.approx(angle, abs=1e-5)
    assert translation_error_m(truth, wrong) == pytest.approx(shift, abs=1e-9)
    assert translation_error_at_m(truth, wrong, np.zeros(3)) == pytest.approx(shift, abs=1e-9)


def test_the_centroid_error_sees_a_rotation_about_the_origin() -> None:
    wrong = turn(90.0, np.array([0.0, 0.0, 1.0]), np.zeros(3))
    assert translation_error_m(np.eye(4), wrong) == 0.0
    at = translation_error_at_m(np.eye(4), wrong, np.array([2.0, 0.0, 5.0]))
    assert at == pytest.approx(2.0 * np.sqrt(2.0))


def test_both_bounds_must_hold() -> None:
    right = within(np.array([15.0, 15.1, 3.0]), np.array([0.3, 0.1, 0.31]))
    assert right.tolist() == [True, False, False]


def test_top_k_follows_the_methods_own_order() -> None:
    assert [best_of_top_k([30.0, 40.0, 2.0], k) for k in (1, 2, 3)] == [0, 0, 2]
    assert best_of_top_k([], 5) is None


@given(SEEDS)
def test_no_world_frame_changes_absolute_errors(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = random_poses(rng, 5)
    estimate: list[Array | None] = list(truth @ se3.exp(0.2 * rng.normal(size=(5, 6))))
    estimate[2] = None
    reference = absolute_errors(truth, estimate)
    gauge_truth, gauge_estimate = random_poses(rng, 2)
    moved = [None if pose is None else gauge_estimate @ pose for pose in estimate]
    other = absolute_errors(gauge_truth @ truth, moved)
    np.testing.assert_allclose(other.rotation_deg, reference.rotation_deg, atol=1e-5)
    np.testing.assert_allclose(other.translation_m, reference.translation_m, atol=1e-8)
    assert other.agreeing.tolist() == reference.agreeing.tolist()


@given(SEEDS)
def test_a_perfect_estimate_in_another_world_has_no_error(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth, gauge = random_poses(rng, 4), random_poses(rng, 1)[0]
    errors = absolute_errors(truth, list(gauge @ truth))
    np.testing.assert_allclose(errors.rotation_deg, 0.0, atol=1e-5)
    np.testing.assert_allclose(errors.translation_m, 0.0, atol=1e-8)
    np.testing.assert_allclose(errors.truth_T_world, se3.inverse(gauge), atol=1e-8)


def test_the_gauge_is_the_chordal_mean() -> None:
    z = np.array([0.0, 0.0, 1.0])
    estimate = np.stack([turn(angle, z, np.zeros(3)) for angle in (-10.0, 0.0, 10.0, 20.0)])
    truth = np.stack([np.eye(4)] * 4)
    gauge = align(truth, estimate)
    assert rotation_error_deg(gauge, turn(-5.0, z, np.zeros(3))) == pytest.approx(0.0, abs=1e-5)


def test_an_unplaced_scan_stands_where_the_first_placed_one_does() -> None:
    truth = np.stack([turn(30.0 * i, np.array([0.0, 1.0, 0.0]), i * np.ones(3)) for i in range(3)])
    gauge = turn(70.0, np.ones(3), np.array([4.0, -1.0, 2.0]))
    errors = absolute_errors(truth, [gauge @ truth[0], gauge @ truth[1], None])
    assert errors.placed.tolist() == [True, True, False]
    np.testing.assert_allclose(errors.rotation_deg, [0.0, 0.0, 60.0], atol=1e-5)
    np.testing.assert_allclose(errors.translation_m, [0.0, 0.0, 2.0 * np.sqrt(3.0)], atol=1e-8)


def test_one_placed_scan_is_no_answer() -> None:
    truth = random_poses(np.random.default_rng(0), 4)
    alone = absolute_errors(truth, [truth[0], None, None, None])
    nothing = absolute_errors(truth, [None] * 4)
    identity = absolute_errors(truth, [np.eye(4)] * 4)
    assert not alone.placed.any() and not alone.agreeing.any()
    np.testing.assert_array_equal(alone.rotation_deg, nothing.rotation_deg)
    np.testing.assert_allclose(nothing.rotation_deg, identity.rotation_deg)
    np.testing.assert_allclose(nothing.translation_m, identity.translation_m)


def test_scans_that_agree_are_found_beside_one_that_is_far_off() -> None:
    truth = random_poses(np.random.default_rng(1), 5)
    estimate = list(truth.copy())
    estimate[3] = turn(100.0, np.ones(3), 10.0 * np.ones(3)) @ truth[3]
    errors = absolute_errors(truth, estimate)
    assert not errors.right.any()
    assert errors.agreeing.tolist() == [True, True, True, False, True]


@settings(max_examples=20)
@given(SEEDS)
def test_overlap_depends_on_no_frame_and_no_order(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(0, 2, size=(300, 3)), rng.uniform(0, 2, size=(200, 3))
    pose = random_poses(rng, 1)[0]
    expected = KDTree(a).query(b)[0]
    share = float((expected < 0.05).mean())
    in_a = se3.transform(se3.inverse(pose), b)
    assert overlap(in_a, a, pose) == pytest.approx(share)
    assert overlap(a, in_a, se3.inverse(pose)) == pytest.approx(share)


def test_a_half_shared_wall_overlaps_by_half() -> None:
    y, z = np.mgrid[0:2:0.03, 0:1:0.03]
    wall = np.stack([np.zeros(y.size), y.ravel(), z.ravel()], axis=-1)
    shift = se3.pose(np.eye(3), np.array([0.0, 1.0, 0.0]))
    assert overlap(wall, wall, shift) == pytest.approx(0.52, abs=0.03)
    assert overlap(wall, np.empty((0, 3)), shift) == 0.0


def test_the_fast_overlap_is_close_to_the_exact_one() -> None:
    rng = np.random.default_rng(0)
    near, far = rng.uniform(0, 1, size=(60_000, 3)), rng.uniform(0, 1, size=(20_000, 3))
    near[:, 2] = far[:, 2] = 0.0
    near[:, 0] *= 0.4
    poses = np.stack([np.eye(4), se3.pose(np.eye(3), np.array([0.2, 0.3, 0.0]))])
    exact = overlap(near, far, relative(poses[0], poses[1]))
    matrix = overlap_matrix([near, far], poses)
    assert matrix[0, 1] == matrix[1, 0] == pytest.approx(exact, abs=0.02)
    assert exact == pytest.approx(0.25 * 0.75, abs=0.02)  # of the 20,000, not of the smaller area


def test_overlap_classes_have_exclusive_upper_bounds() -> None:
    names = [overlap_class(value) for value in (0.0, 0.01, 0.1, 0.3, 0.5, 1.0)]
    assert names == ["< 1 %", "1-10 %", "10-30 %", "30-50 %", ">= 50 %", ">= 50 %"]


def test_thinning_keeps_one_centroid_a_voxel() -> None:
    points = np.array([[0.01, 0.0, 0.0], [0.02, 0.0, 0.0], [-0.01, 0.0, 0.0], [1.0, 1.0, 1.0]])
    thinned = thin(points, 0.05)
    expected = [[-0.01, 0.0, 0.0], [0.015, 0.0, 0.0], [1.0, 1.0, 1.0]]
    np.testing.assert_allclose(thinned, expected)


def test_calibrated_answers_have_no_calibration_error() -> None:
    rng = np.random.default_rng(3)
    probability = rng.random(40_000)
    right = rng.random(40_000) < probability
    assert expected_calibration_error(probability, right) < 0.01
    assert expected_calibration_error(probability, ~right) > 0.4


def test_reliability_counts_every_answer_once() -> None:
    groups = reliability(np.array([0.0, 0.1, 0.19, 1.0]), np.array([False, False, True, True]))
    assert [(g.low, g.count, g.right) for g in groups] == [
        (0.0, 1, 0.0),
        (0.1, 2, 0.5),
        (0.9, 1, 1),
    ]
    assert expected_calibration_error(np.empty(0), np.empty(0, dtype=bool)) == 0.0


def test_half_a_square_is_accurate_and_half_complete() -> None:
    rng = np.random.default_rng(0)
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    square = sample_surface(corners, np.array([[0, 1, 2], [0, 2, 3]]), 20_000, rng)
    half = square[square[:, 0] < 0.5]
    errors = mesh_errors(half, square, threshold_m=0.02)
    assert errors.accuracy == 1.0
    assert errors.completeness == pytest.approx(0.52, abs=0.01)
    assert errors.f_score == pytest.approx(2 * 0.52 / 1.52, abs=0.01)
    assert square.mean(axis=0) == pytest.approx([0.5, 0.5, 0.0], abs=0.01)


def test_a_report_is_scored_by_its_largest_component() -> None:
    truth = dict(zip("abcde", random_poses(np.random.default_rng(5), 5), strict=True))
    report = make_report(list("abcde"), list(truth.values()))
    report["scans"][0]["component"] = report["scans"][4]["component"] = 1
    scores = evaluate_report(report, truth)
    assert scores["absolute"]["unplaced"] == 2
    assert scores["absolute"]["components"] == 2
    assert scores["absolute"]["agreeing"] == 3
    assert [row["right"] for row in scores["scans"]][1:4] == [True] * 3
    assert scores["calibration"]["scans"]["ece"] == pytest.approx(0.1)
    assert "2 unplaced" in text(scores)


def test_candidates_are_scored_in_rank_order() -> None:
    truth = dict(zip("ab", random_poses(np.random.default_rng(6), 2), strict=True))
    exact = relative(truth["a"], truth["b"])
    poses = [turn(90.0, np.ones(3), np.zeros(3)) @ exact, exact]
    pair = {
        "source": "a",
        "target": "b",
        "selected": 1,
        "candidates": [
            {"rank": rank, "target_T_source": poses[rank].tolist(), "probability": 0.5}
            for rank in (1, 0)
        ],
    }
    missing: dict[str, Any] = {"source": "b", "target": "a", "selected": None, "candidates": []}
    report = make_report(["a", "b"], list(truth.values()), pairs=[pair, missing])
    scores = evaluate_report(
        report, truth, overlaps={("b", "a"): 0.2}, centroids={k: np.ones(3) for k in "ab"}
    )
    summary = scores["pair_summary"]
    assert summary["recall"] == {"1": 0.0, "3": 0.5, "5": 0.5}
    assert summary["without_candidates"] == summary["selected"] == summary["selected_right"] == 1
    identity = float(rotation_error_deg(exact, np.eye(4)))
    assert summary["top"]["1"]["rotation_deg"] == pytest.approx((90.0 + identity) / 2)
    assert summary["by_overlap"]["10-30 %"]["count"] == 2
    assert scores["pairs"][0]["candidates"][1]["centroid_m"] == pytest.approx(0.0, abs=1e-9)
    assert scores["calibration"]["candidates"]["ece"] == pytest.approx(0.0)
    json.dumps(scores, allow_nan=False)


def test_a_confident_mistake_is_counted() -> None:
    truth = dict(zip("abcd", random_poses(np.random.default_rng(8), 4), strict=True))
    poses = list(truth.values())
    poses[3] = turn(170.0, np.ones(3), np.ones(3)) @ poses[3]
    scores = evaluate_report(make_report(list("abcd"), poses), truth)
    assert scores["absolute"]["confidently_wrong"] >= 1


def test_a_report_without_truth_is_refused() -> None:
    report = make_report(["a"], [np.eye(4)])
    with pytest.raises(FewviewError, match="ground-truth"):
        evaluate_report(report, {})
