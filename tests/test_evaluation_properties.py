"""Laws of the yardstick that hold for any numbers: frames, orders, bounds, known generators."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fewview.evaluation.calibration import expected_calibration_error, reliability
from fewview.evaluation.gauge import absolute_errors, align
from fewview.evaluation.mesh import mesh_errors
from fewview.evaluation.metrics import (
    best_of_top_k,
    relative,
    rotation_error_deg,
    translation_error_at_m,
    translation_error_m,
)
from fewview.evaluation.overlap import CLASSES, overlap_class, overlap_matrix
from fewview.geometry import se3
from fewview.types import Array

SEEDS = st.integers(0, 2**32 - 1)


def random_poses(rng: np.random.Generator, count: int) -> Array:
    return se3.exp(rng.normal(size=(count, 6)) * np.array([2.0] * 3 + [3.0] * 3))


def plane(size_m: float = 1.0, spacing_m: float = 0.01) -> Array:
    """Points on a square at z = 0."""
    x, y = np.mgrid[0 : size_m + 1e-9 : spacing_m, 0 : size_m + 1e-9 : spacing_m]
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=-1)


@given(SEEDS)
def test_no_world_frame_changes_a_relative_pose(seed: int) -> None:
    rng = np.random.default_rng(seed)
    source, target, estimate, world = random_poses(rng, 4)
    truth, moved = relative(source, target), relative(world @ source, world @ target)
    np.testing.assert_allclose(moved, truth, atol=1e-9)
    points = rng.normal(size=(7, 3))
    here = se3.transform(truth, points)
    np.testing.assert_allclose(
        se3.transform(target, here), se3.transform(source, points), atol=1e-9
    )
    assert rotation_error_deg(moved, estimate) == pytest.approx(
        float(rotation_error_deg(truth, estimate)), abs=1e-5
    )


@given(SEEDS)
def test_no_frame_of_the_target_changes_an_error(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth, estimate, other_T_target = random_poses(rng, 3)
    point = rng.normal(size=3)
    pair = (other_T_target @ truth, other_T_target @ estimate)
    assert translation_error_m(*pair) == pytest.approx(float(translation_error_m(truth, estimate)))
    assert translation_error_at_m(*pair, point) == pytest.approx(
        float(translation_error_at_m(truth, estimate, point))
    )
    assert rotation_error_deg(*pair) == pytest.approx(
        float(rotation_error_deg(truth, estimate)), abs=1e-5
    )


@given(SEEDS)
def test_the_error_at_a_point_does_not_see_where_the_camera_stood(seed: int) -> None:
    """Another source frame moves the origin's error, but not that at a point of the scan."""
    rng = np.random.default_rng(seed)
    truth, estimate, source_T_other = random_poses(rng, 3)
    point = rng.normal(size=3)
    in_other = se3.transform(se3.inverse(source_T_other), point[None])[0]
    pair = (truth @ source_T_other, estimate @ source_T_other)
    expected = float(translation_error_at_m(truth, estimate, point))
    assert translation_error_at_m(*pair, in_other) == pytest.approx(expected)
    assert translation_error_m(*pair) != pytest.approx(float(translation_error_m(truth, estimate)))


@given(SEEDS)
def test_rotation_errors_are_a_distance(seed: int) -> None:
    a, b, c = random_poses(np.random.default_rng(seed), 3)
    assert rotation_error_deg(a, b) == pytest.approx(float(rotation_error_deg(b, a)), abs=1e-5)
    assert rotation_error_deg(a, c) <= rotation_error_deg(a, b) + rotation_error_deg(b, c) + 1e-5
    assert 0.0 <= rotation_error_deg(a, b) <= 180.0


@given(st.lists(st.floats(0.0, 180.0), min_size=1, max_size=8))
def test_more_candidates_never_make_the_best_worse(errors: list[float]) -> None:
    chosen = [best_of_top_k(errors, k) for k in range(1, 10)]
    best = [errors[i] for i in chosen if i is not None]
    assert len(best) == 9
    assert best == sorted(best, reverse=True)
    assert best[0] == errors[0] and best[-1] == min(errors)


@given(SEEDS)
def test_a_gauge_takes_any_world_motion_away(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = random_poses(rng, 6)
    estimate = truth @ se3.exp(0.2 * rng.normal(size=(6, 6)))
    world, other = random_poses(rng, 2)
    gauge = align(truth, estimate)
    np.testing.assert_allclose(align(truth, world @ estimate) @ world, gauge, atol=1e-8)
    np.testing.assert_allclose(align(other @ truth, estimate), other @ gauge, atol=1e-8)


@given(SEEDS)
def test_the_order_of_scans_does_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = random_poses(rng, 5)
    estimate = list(truth @ se3.exp(0.3 * rng.normal(size=(5, 6))))
    order = rng.permutation(5)
    errors = absolute_errors(truth, estimate)
    shuffled = absolute_errors(truth[order], [estimate[i] for i in order])
    np.testing.assert_allclose(shuffled.rotation_deg, errors.rotation_deg[order], atol=1e-5)
    np.testing.assert_allclose(shuffled.translation_m, errors.translation_m[order], atol=1e-8)


@settings(max_examples=20)
@given(SEEDS)
def test_no_world_frame_and_no_order_changes_an_overlap_matrix(seed: int) -> None:
    rng = np.random.default_rng(seed)
    clouds = [rng.uniform(0, 1, size=(n, 3)) * [1.0, 1.0, 0.0] for n in (1500, 1000, 700)]
    poses = se3.exp(0.3 * rng.normal(size=(3, 6)))
    matrix = overlap_matrix(clouds, poses)
    assert np.array_equal(matrix, matrix.T) and (np.diag(matrix) == 1.0).all()
    moved = overlap_matrix(clouds, random_poses(rng, 1)[0] @ poses)
    np.testing.assert_allclose(moved, matrix, atol=0.06)  # thinning sees the world's axes
    swapped = overlap_matrix(clouds[::-1], poses[::-1])
    np.testing.assert_allclose(swapped, matrix[::-1, ::-1])


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_overlap_classes_rise_with_the_overlap(first: float, second: float) -> None:
    names = [name for _, name in CLASSES]
    low, high = sorted((first, second))
    assert names.index(overlap_class(low)) <= names.index(overlap_class(high))


@pytest.mark.parametrize(("shift", "right"), [(0.0, 1.0), (0.03, 1.0), (0.049, 1.0), (0.051, 0.0)])
def test_a_plane_shifted_along_its_normal_is_off_by_the_shift(shift: float, right: float) -> None:
    errors = mesh_errors(plane() + [0.0, 0.0, shift], plane(), threshold_m=0.05)
    assert errors.accuracy == errors.completeness == errors.f_score == right
    assert errors.accuracy_m == pytest.approx(shift) == errors.completeness_m


def test_a_plane_shifted_along_itself_is_off_where_it_sticks_out() -> None:
    errors = mesh_errors(plane() + [0.25, 0.0, 0.0], plane(), threshold_m=0.0501)
    assert errors.accuracy == pytest.approx(0.8, abs=0.01)
    assert errors.completeness == pytest.approx(0.8, abs=0.01)
    assert errors.accuracy_m == errors.completeness_m == pytest.approx(0.0, abs=1e-9)


@settings(max_examples=20)
@given(SEEDS)
def test_no_frame_changes_mesh_errors_and_swapping_swaps_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    estimate, truth = plane(0.5, 0.02), plane(0.8, 0.02) + rng.normal(0.0, 0.02, size=3)
    pose = random_poses(rng, 1)[0]
    errors = mesh_errors(estimate, truth, 0.03)
    moved = mesh_errors(se3.transform(pose, estimate), se3.transform(pose, truth), 0.03)
    swapped = mesh_errors(truth, estimate, 0.03)
    assert moved.accuracy_m == pytest.approx(errors.accuracy_m)
    assert moved.completeness_m == pytest.approx(errors.completeness_m)
    assert (swapped.accuracy, swapped.completeness) == (errors.completeness, errors.accuracy)


@pytest.mark.parametrize(("power", "expected"), [(1.0, 0.0), (2.0, 1 / 6), (0.5, 1 / 6)])
def test_a_known_generator_has_its_known_calibration_error(power: float, expected: float) -> None:
    """Answers right with chance p^power are off by the integral of |p - p^power| over 0..1."""
    rng = np.random.default_rng(7)
    said = rng.random(60_000)
    right = rng.random(60_000) < said**power
    assert expected_calibration_error(said, right) == pytest.approx(expected, abs=0.01)
    for group in reliability(said, right):
        assert group.right == pytest.approx(group.probability**power, abs=0.03)


@given(SEEDS, st.integers(1, 20))
def test_reliability_adds_up(seed: int, bins: int) -> None:
    rng = np.random.default_rng(seed)
    said, right = rng.random(200), rng.random(200) < 0.4
    groups = reliability(said, right, bins)
    assert sum(g.count for g in groups) == 200
    assert sum(g.count * g.right for g in groups) == pytest.approx(right.sum())
    assert sum(g.count * g.probability for g in groups) == pytest.approx(said.sum())
    assert all(g.low <= g.probability <= g.high for g in groups)
