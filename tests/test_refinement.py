"""The robust regression against finite differences and known poses; relations; evidence."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from fewview.config import RefinementConfig
from fewview.geometry import se3
from fewview.refinement import regression
from fewview.refinement.relations import Relations
from fewview.types import Surface


def box_surface(rng: np.random.Generator, count: int = 1500) -> Surface:
    """Points on the inside of a 4 x 3 x 2.5 m box with a block in it."""
    points, normals = [], []
    size = np.array([4.0, 3.0, 2.5])
    for axis in range(3):
        for side in (0.0, 1.0):
            p = rng.uniform(0, 1, (count // 6, 3))
            p[:, axis] = side
            n = np.zeros((count // 6, 3))
            n[:, axis] = 1.0 - 2.0 * side
            points.append(p * size - size / 2)
            normals.append(n)
    p, n = np.concatenate(points), np.concatenate(normals)
    return Surface(p, n, np.zeros((len(p), 3), np.float32), np.full(len(p), -1))


def no_relations(count: int) -> Relations:
    nothing, none = np.zeros((0, 3)), np.zeros((count, 0))
    return Relations(nothing, nothing, nothing, nothing, np.zeros(0), none, none, none)


def no_matches(count: int) -> regression.Matches:
    return regression.Matches(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((count, 0)))


def searchable(surface: Surface) -> tuple[Surface, cKDTree]:
    return surface, cKDTree(surface.points)


@pytest.mark.parametrize("name", ["coplanar", "parallel", "perpendicular", "point"])
def test_jacobians_match_finite_differences(name: str) -> None:
    rng = np.random.default_rng(3)
    p, q = rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    n, m = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, 5, 3)))
    weight = np.ones(5)

    def term(pose: np.ndarray) -> regression._Term:
        if name == "coplanar":
            return regression.coplanar_term(pose, p, n, q, m, weight, 0.1)
        if name == "point":
            return regression.point_term(pose, p, q, weight, 0.1)
        make = regression.parallel_term if name == "parallel" else regression.perpendicular_term
        return make(pose, n, m, weight, 0.1)

    pose = se3.exp(rng.normal(size=(2, 6)))
    step = 1e-6
    for k in range(6):
        delta = np.zeros(6)
        delta[k] = step
        ahead, behind = term(se3.exp(delta) @ pose), term(se3.exp(-delta) @ pose)
        numeric = (ahead.residual - behind.residual) / (2 * step)
        np.testing.assert_allclose(term(pose).jacobian[..., k], numeric, atol=1e-6)


def test_terms_are_the_papers_residuals() -> None:
    rng = np.random.default_rng(4)
    p, q = rng.normal(size=(1, 3)), rng.normal(size=(1, 3))
    n, m = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, 1, 3)))
    pose = se3.exp(rng.normal(size=(1, 6)))
    rotation, shift = pose[0, :3, :3], pose[0, :3, 3]
    gap, turned = rotation @ p[0] + shift - q[0], rotation @ n[0]
    one = np.ones(1)
    square = [
        (regression.coplanar_term(pose, p, n, q, m, one, 1.0).residual ** 2).sum(),
        (regression.parallel_term(pose, n, m, one, 1.0).residual ** 2).sum(),
        (regression.perpendicular_term(pose, n, m, one, 1.0).residual ** 2).sum(),
    ]
    expected = [
        (gap @ m[0]) ** 2 + (gap @ turned) ** 2,
        1 - (turned @ m[0]) ** 2,
        (turned @ m[0]) ** 2,
    ]
    np.testing.assert_allclose(square, expected, atol=1e-12)


def test_known_pose_is_recovered_for_all_candidates_at_once() -> None:
    rng = np.random.default_rng(0)
    target = box_surface(rng)
    truth = se3.exp(np.array([0.2, -0.4, 0.9, 0.5, -0.3, 0.2]))
    inverse = se3.inverse(truth)
    noisy = target.points + rng.normal(scale=0.004, size=target.points.shape)
    source = Surface(
        se3.transform(inverse, noisy),
        se3.rotate(inverse, target.normals),
        target.colours,
        target.labels,
    )
    nudges = rng.uniform(-1, 1, (4, 6)) * np.array([0.05, 0.05, 0.05, 0.08, 0.08, 0.08])
    start = se3.exp(nudges) @ truth
    refined = regression.refine(
        searchable(source),
        searchable(target),
        start,
        no_relations(4),
        no_matches(4),
        RefinementConfig(),
    )
    angle, shift = se3.distance(refined.target_T_source, truth)
    before_angle, before_shift = se3.distance(start, truth)
    assert (np.degrees(angle) < 0.3).all() and (shift < 0.01).all()
    assert (before_angle > 3 * angle).all() and (before_shift > 3 * shift).all()
    assert refined.converged.all()
    assert (np.linalg.eigvalsh(refined.covariance) > 0).all()
    back = se3.adjoint(se3.inverse(refined.target_T_source))
    inverse = back @ np.linalg.inv(refined.hessian) @ np.swapaxes(back, 1, 2)
    ratio = refined.covariance[:, range(6), range(6)] / inverse[:, range(6), range(6)]
    np.testing.assert_allclose(ratio, np.repeat(ratio[:, :1], 6, axis=1), rtol=1e-3)


def test_no_iterations_leave_poses_as_proposed_but_say_how_sure_they_are() -> None:
    rng = np.random.default_rng(8)
    surface = searchable(box_surface(rng))
    start = se3.exp(np.array([[0.02, 0.0, 0.01, 0.03, 0.0, -0.02]]))
    config = RefinementConfig(iterations=0)
    refined = regression.refine(surface, surface, start, no_relations(1), no_matches(1), config)
    np.testing.assert_allclose(refined.target_T_source, start, atol=1e-12)
    assert (np.linalg.eigvalsh(refined.covariance[0]) > 0).all()


def test_matches_keep_a_scan_from_sliding_along_a_wall() -> None:
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-1, 1, (800, 2)), np.full(800, 2.0)])
    normals = np.tile([0.0, 0.0, -1.0], (800, 1))
    wall = Surface(points, normals, np.zeros((800, 3), np.float32), np.full(800, -1))
    start = se3.exp(np.array([[0.0, 0.0, 0.0, 0.06, 0.0, 0.0]]))
    anchors = points[:12]
    matches = regression.Matches(anchors, anchors, np.ones((1, 12)))
    arguments = (searchable(wall), searchable(wall), start, no_relations(1))
    held = regression.refine(*arguments, matches, RefinementConfig())
    loose = regression.refine(*arguments, no_matches(1), RefinementConfig())
    assert np.linalg.norm(held.target_T_source[0, :3, 3]) < 0.005
    assert loose.target_T_source[0, 0, 3] > 0.04


def test_relations_of_patches_pull_planes_together() -> None:
    rng = np.random.default_rng(2)
    normals = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])
    centres = rng.normal(size=(3, 3))
    truth = se3.exp(np.array([0.1, -0.2, 0.15, 0.3, 0.1, -0.2]))
    i, j = np.divmod(np.arange(9), 3)
    q, m = se3.transform(truth, centres)[j], se3.rotate(truth, normals)[j]
    relations = Relations(
        centres[i],
        q,
        normals[i],
        m,
        np.full(9, 100.0),
        (i == j)[None].astype(float),
        np.zeros((1, 9)),
        (i != j)[None].astype(float),
    )
    empty = Surface(np.full((3, 3), 50.0), normals, np.zeros((3, 3), np.float32), np.full(3, -1))
    far = Surface(np.full((3, 3), -50.0), normals, empty.colours, empty.labels)
    start = se3.exp(np.array([[0.05, 0.04, -0.05, 0.05, -0.05, 0.02]])) @ truth
    refined = regression.refine(
        searchable(empty),
        searchable(far),
        start,
        relations,
        no_matches(1),
        RefinementConfig(gauss_newton_steps=8),
    )
    angle, shift = se3.distance(refined.target_T_source, truth)
    assert np.degrees(angle[0]) < 0.1 and shift[0] < 0.01
