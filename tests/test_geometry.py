"""Rigid motions and cameras: identities that must hold for any motion."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial import cKDTree

from fewview.geometry import camera, se3
from fewview.geometry.vicinity import Vicinity
from fewview.types import Intrinsics

tangents = hnp.arrays(np.float64, 6, elements=st.floats(-3.0, 3.0, width=32))


@given(tangents, tangents)
def test_adjoint_moves_a_perturbation_to_the_other_side(xi: np.ndarray, eta: np.ndarray) -> None:
    pose = se3.exp(xi)
    small = 1e-4 * eta
    left = pose @ se3.exp(small)
    right = se3.exp(se3.adjoint(pose) @ small) @ pose
    np.testing.assert_allclose(left, right, atol=1e-9)


@given(tangents)
def test_inverse_undoes(xi: np.ndarray) -> None:
    pose = se3.exp(xi)
    np.testing.assert_allclose(se3.inverse(pose) @ pose, np.eye(4), atol=1e-9)


@given(hnp.arrays(np.float64, 3, elements=st.floats(-1.75, 1.75, width=32)))
def test_log_of_exp_is_the_vector(omega: np.ndarray) -> None:
    np.testing.assert_allclose(se3.rotation_log(se3.rotation_exp(omega)), omega, atol=1e-6)


def test_log_of_half_turns_has_length_pi() -> None:
    for axis in np.eye(3):
        half = se3.rotation_exp(np.pi * axis)
        np.testing.assert_allclose(np.linalg.norm(se3.rotation_log(half)), np.pi, atol=1e-6)


@given(st.floats(1e-4, 3.1))
def test_rotation_angle(angle: float) -> None:
    rotation = se3.rotation_exp(angle * np.array([0.6, 0.0, 0.8]))
    np.testing.assert_allclose(se3.rotation_angle(rotation), angle, rtol=1e-5)


def test_projection_inverts_backprojection() -> None:
    intrinsics = Intrinsics(64, 48, 55.0, 57.0, 30.2, 25.1)
    depth = np.linspace(0.5, 4.0, 64 * 48, dtype=np.float32).reshape(48, 64)
    points = camera.backproject(depth, intrinsics).astype(np.float64)
    pixels, inside = camera.project(points, intrinsics)
    rows, columns = np.indices(depth.shape)
    assert inside.all()
    np.testing.assert_allclose(pixels[..., 0], columns, atol=1e-4)
    np.testing.assert_allclose(pixels[..., 1], rows, atol=1e-4)


def test_points_behind_the_camera_are_outside() -> None:
    intrinsics = Intrinsics(64, 48, 55.0, 57.0, 30.2, 25.1)
    _, inside = camera.project(np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]), intrinsics)
    assert inside.tolist() == [False, True]


def test_depth_edges_mark_both_sides_of_a_jump() -> None:
    depth = np.ones((5, 6), dtype=np.float32)
    depth[:, 3:] = 2.0
    edges = camera.depth_edges(depth)
    assert edges[:, 2:4].all()
    assert not edges[:, :2].any() and not edges[:, 4:].any()


def test_resized_intrinsics_keep_the_viewing_rays() -> None:
    full = Intrinsics(640, 480, 525.0, 525.0, 319.5, 239.5)
    half = full.resized(320, 240)
    corner_full = (-0.5 - full.cx) / full.fx
    corner_half = (-0.5 - half.cx) / half.fx
    np.testing.assert_allclose(corner_half, corner_full)


def test_no_point_near_a_surface_is_outside_its_vicinity() -> None:
    rng = np.random.default_rng(0)
    surface, distance = rng.uniform(-1.0, 1.0, (400, 3)), 0.08
    points = np.concatenate([surface, rng.uniform(-1.5, 1.5, (20_000, 3))])
    near = np.isfinite(cKDTree(surface).query(points, distance_upper_bound=distance)[0])
    may_hold = Vicinity.of(surface, distance).may_hold(points)
    assert near.sum() > 500 and not np.any(near & ~may_hold)
    assert may_hold.mean() < 0.2


def test_nothing_is_in_the_vicinity_of_nothing() -> None:
    assert not Vicinity.of(np.empty((0, 3)), 0.08).may_hold(np.zeros((4, 3))).any()
