"""Labels of geometric relations, the perturbation of poses, and the confusion matrix."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fewview.evaluation.metrics import rotation_error_deg
from fewview.evaluation.relations import (
    Relation,
    accuracies,
    confusion,
    perturbed,
    read_relations,
    row_shares,
    true_relations,
)
from fewview.geometry import se3
from fewview.types import Array, IntArray

SEEDS = st.integers(0, 2**32 - 1)
Z = np.array([0.0, 0.0, 1.0])


def random_pose(rng: np.random.Generator) -> Array:
    return se3.exp(rng.normal(size=6) * np.array([2.0] * 3 + [3.0] * 3))


def tilted(angle_deg: float) -> Array:
    """A unit vector that far from z."""
    angle = np.radians(angle_deg)
    return np.array([np.sin(angle), 0.0, np.cos(angle)])


def one(point: Array, normal: Array, tilt_deg: float = 5.0, offset_m: float = 0.05) -> Relation:
    """The relation of a point on the plane z = 0 with another, in one frame."""
    pair = (point[None], normal[None], np.zeros((1, 3)), Z[None])
    found = read_relations(*pair, np.eye(4), tilt_deg, offset_m)
    return Relation(int(found[0]))


def room(rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Points on axis-parallel and on slanted planes with few different offsets."""
    normals = np.eye(3)[rng.integers(3, size=count)] * rng.choice([-1.0, 1.0], size=(count, 1))
    normals[::4] = rng.normal(size=normals[::4].shape)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    points = np.asarray(rng.integers(-2, 3, size=(count, 3)) * 0.4)
    return points, np.asarray(normals)


def moved(a_T_b: Array, points: Array, normals: Array) -> tuple[Array, Array]:
    return se3.transform(a_T_b, points), se3.rotate(a_T_b, normals)


@pytest.mark.parametrize(
    ("height", "angle_deg", "expected"),
    [
        (0.0, 0.0, Relation.COPLANAR),
        (0.049, 4.9, Relation.COPLANAR),
        (0.051, 0.0, Relation.PARALLEL),
        (1.0, 4.9, Relation.PARALLEL),
        (0.0, 5.1, Relation.NONE),
        (0.0, 180.0, Relation.PARALLEL),
        (1.0, 175.1, Relation.PARALLEL),
        (1.0, 174.9, Relation.NONE),
        (0.0, 45.0, Relation.NONE),
        (0.0, 84.9, Relation.NONE),
        (0.0, 85.1, Relation.PERPENDICULAR),
        (2.0, 94.9, Relation.PERPENDICULAR),
    ],
)
def test_known_relations(height: float, angle_deg: float, expected: Relation) -> None:
    assert one(np.array([0.0, 0.0, height]), tilted(angle_deg)) is expected


def test_coplanar_asks_both_planes() -> None:
    """Far along the target's plane, a small tilt of the source's own plane misses the target."""
    far = np.array([3.0, 0.0, 0.0])
    assert one(far, tilted(0.5)) is Relation.COPLANAR
    assert one(far, tilted(2.0)) is Relation.PARALLEL


def test_wider_tolerances_see_more() -> None:
    assert one(np.array([0.0, 0.0, 0.2]), tilted(10.0)) is Relation.NONE
    assert one(np.array([0.0, 0.0, 0.2]), tilted(10.0), 15.0, 0.3) is Relation.COPLANAR


@given(SEEDS)
def test_no_frame_changes_a_label(seed: int) -> None:
    rng = np.random.default_rng(seed)
    source, target = room(rng, 400), room(rng, 400)
    expected = true_relations(*source, *target, np.eye(4))
    a, b = random_pose(rng), random_pose(rng)
    found = true_relations(*moved(a, *source), *moved(b, *target), b @ se3.inverse(a))
    assert set(expected.tolist()) == set(Relation)
    np.testing.assert_array_equal(found, expected)


@given(SEEDS)
def test_labels_are_the_same_both_ways(seed: int) -> None:
    rng = np.random.default_rng(seed)
    source, target, pose = room(rng, 400), room(rng, 400), random_pose(rng)
    there = true_relations(*source, *target, pose)
    np.testing.assert_array_equal(true_relations(*target, *source, se3.inverse(pose)), there)


@given(SEEDS, st.floats(0.0, 60.0), st.floats(0.0, 2.0))
def test_perturbations_stay_in_their_bounds(seed: int, max_deg: float, max_m: float) -> None:
    rng = np.random.default_rng(seed)
    truth = random_pose(rng)
    off = perturbed(truth, rng, max_deg, max_m)
    assert rotation_error_deg(truth, off) <= max_deg + 1e-5
    assert np.abs(off[:3, 3] - truth[:3, 3]).max() <= max_m + 1e-12
    np.testing.assert_allclose(off[:3, :3].T @ off[:3, :3], np.eye(3), atol=1e-9)


def test_perturbations_fill_their_bounds_evenly() -> None:
    rng = np.random.default_rng(0)
    off = np.stack([perturbed(np.eye(4), rng) for _ in range(2000)])
    angles = rotation_error_deg(np.eye(4), off)
    shares, _ = np.histogram(angles, bins=3, range=(0.0, 30.0))
    np.testing.assert_allclose(shares / 2000, 1 / 3, atol=0.04)
    np.testing.assert_allclose(off[:, :3, 3].min(axis=0), -0.5, atol=0.01)
    np.testing.assert_allclose(off[:, :3, 3].mean(axis=0), 0.0, atol=0.03)
    axes = se3.rotation_log(off[:, :3, :3])
    np.testing.assert_allclose(axes.mean(axis=0), 0.0, atol=0.02)


def test_the_same_seed_perturbs_alike() -> None:
    first, second, other = (perturbed(np.eye(4), np.random.default_rng(s)) for s in (1, 1, 2))
    np.testing.assert_array_equal(first, second)
    assert not np.allclose(first, other)


def test_confusion_counts_labels_in_rows() -> None:
    labels: IntArray = np.array([0, 0, 1, 3, 3, 3])
    predicted: IntArray = np.array([0, 2, 1, 3, 1, 3])
    counts = confusion(labels, predicted)
    expected = [[1, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 0], [0, 1, 0, 2]]
    np.testing.assert_array_equal(counts, expected)
    np.testing.assert_allclose(accuracies(counts), [0.5, 1.0, np.nan, 2 / 3])
    np.testing.assert_allclose(row_shares(counts)[3], [0.0, 1 / 3, 0.0, 2 / 3])


def test_nothing_to_count_is_no_accuracy() -> None:
    empty: IntArray = np.empty(0, dtype=np.int64)
    counts = confusion(empty, empty)
    assert counts.shape == (4, 4) and not counts.any()
    assert np.isnan(accuracies(counts)).all()
