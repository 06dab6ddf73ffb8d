"""Pair methods: each finds a known motion, says the same twice, and survives an empty scan."""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
import pytest
from scipy.spatial import KDTree

from benchmark.methods.clouds import registration
from benchmark.methods.common_set import Vicinity, largest
from benchmark.methods.congruent_sets import Base, Sample, congruent_sets, wide_base
from benchmark.methods.fgr import FGR
from benchmark.methods.four_points import FourPoints
from benchmark.methods.interface import Answer, PairMethod
from benchmark.methods.kiss import Kiss
from benchmark.methods.ransac import Ransac
from benchmark.methods.sparse_icp import Parameters, SparseICP, shrink, sparse_icp
from benchmark.methods.trivial import (
    Identity,
    ManhattanFacingAway,
    ManhattanRandom,
    UniformYaw,
)
from benchmark.methods.xfeat import XFeat
from fewview import synthetic
from fewview.evaluation.overlap import overlap
from fewview.geometry import camera, se3
from fewview.types import Array, Frame

ALIGNING: dict[str, PairMethod] = {
    "fgr": FGR(icp=False),
    "ransac": Ransac(icp=False),
    "kiss": Kiss(),
    "xfeat": XFeat(),
    "four points": FourPoints(),
    "sparse icp": SparseICP(),
}
GUESSING: dict[str, PairMethod] = {
    "identity": Identity(),
    "uniform yaw": UniformYaw(),
    "manhattan random": ManhattanRandom(),
    "manhattan facing away": ManhattanFacingAway(),
}
METHODS: dict[str, PairMethod] = {**ALIGNING, **GUESSING}
MOTION = se3.exp(np.array([0.02, 0.10, 0.02, 0.15, 0.02, -0.10]))


@cache
def views() -> tuple[Frame, Frame, Array, Array]:
    """Two frames, target_T_source, and the (3, 3) camera-to-world rotation of the source."""
    room = synthetic.make_room(synthetic.split_seed("validation", 0))
    intrinsics, rng = synthetic.kinect(320, 240), np.random.default_rng(0)
    world_T_source = synthetic.sample_views(room, 2, 4, "random", intrinsics)[0]
    world_T_target = world_T_source @ MOTION
    source, target = (
        synthetic.render(room, pose, intrinsics, rng) for pose in (world_T_source, world_T_target)
    )
    assert overlap(points_of(source), points_of(target), se3.inverse(MOTION)) > 0.6
    return source, target, se3.inverse(MOTION), world_T_source[:3, :3]


def points_of(frame: Frame) -> Array:
    points = camera.backproject(frame.depth, frame.intrinsics)
    return points[frame.depth > 0].astype(np.float64)


@cache
def prepared(name: str) -> tuple[Any, Any]:
    source, target, _, _ = views()
    return METHODS[name].prepare(source), METHODS[name].prepare(target)


@cache
def answer_of(name: str) -> Answer:
    return METHODS[name].match(*prepared(name))


def errors(truth: Array, found: Array) -> tuple[float, float]:
    rotation, shift = se3.distance(truth, found)
    return float(np.degrees(rotation)), float(shift)


@pytest.mark.parametrize("name", ALIGNING)
def test_a_known_motion_is_found(name: str) -> None:
    (candidate,) = answer_of(name).candidates
    rotation_deg, shift_m = errors(views()[2], candidate.target_T_source)
    assert rotation_deg < 4.0
    assert shift_m < 0.10
    assert candidate.score >= 3
    assert candidate.overlap is not None and 0.1 < candidate.overlap <= 1.0
    assert candidate.information is not None and candidate.information.shape == (6, 6)


@pytest.mark.parametrize("method", [FGR(), Ransac(), FourPoints(icp=True)])
def test_icp_makes_it_precise(method: PairMethod) -> None:
    source, target, truth, _ = views()
    (candidate,) = method.match(method.prepare(source), method.prepare(target)).candidates
    rotation_deg, shift_m = errors(truth, candidate.target_T_source)
    assert rotation_deg < 0.2
    assert shift_m < 0.01


@pytest.mark.parametrize("name", METHODS)
def test_the_answer_does_not_depend_on_what_ran_before(name: str) -> None:
    source, target, _, _ = views()
    method = METHODS[name]
    first = answer_of(name)
    o3d.utility.random.seed(7)
    again = method.match(method.prepare(source), method.prepare(target))
    assert 1 <= len(first.candidates) <= method.top_k
    for a, b in zip(first.candidates, again.candidates, strict=True):
        assert a.target_T_source.tobytes() == b.target_T_source.tobytes()
        assert a.score == b.score


@pytest.mark.parametrize("name", METHODS)
def test_a_scan_without_depth_is_no_error(name: str) -> None:
    method, (source, target) = METHODS[name], prepared(name)
    frame = views()[0]
    empty = method.prepare(dataclasses.replace(frame, depth=np.zeros_like(frame.depth)))
    for pair in ((empty, target), (source, empty), (empty, empty)):
        expected = 0 if name in ALIGNING else method.top_k
        assert len(method.match(*pair).candidates) == expected


@pytest.mark.parametrize("name", ["uniform yaw", "manhattan random", "manhattan facing away"])
def test_guesses_keep_gravity_and_place(name: str) -> None:
    _, _, truth, world_R_source = views()
    up = world_R_source.T @ np.array([0.0, 0.0, 1.0])
    for candidate in answer_of(name).candidates:
        pose = candidate.target_T_source
        cosine = (pose[:3, :3] @ up) @ (truth[:3, :3] @ up)
        assert np.degrees(np.arccos(cosine)) < 3.0
        np.testing.assert_array_equal(pose[:3, 3], 0.0)


@pytest.mark.parametrize("name", ["manhattan random", "manhattan facing away"])
def test_one_of_the_four_yaws_is_right(name: str) -> None:
    poses = [candidate.target_T_source for candidate in answer_of(name).candidates]
    turns = sorted(errors(views()[2], pose)[0] for pose in poses)
    assert turns[0] < 4.0
    assert 80.0 < turns[1] < turns[2] < 100.0 < turns[3]


def test_facing_away_comes_first() -> None:
    answer = answer_of("manhattan facing away")
    ahead = [candidate.target_T_source[2, 2] for candidate in answer.candidates]
    assert ahead == sorted(ahead)
    assert errors(views()[2], answer.candidates[0].target_T_source)[0] > 120.0


def box_surface(count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Points and outward normals of a box of 2 x 1.5 x 1 m."""
    points, normals = rng.uniform(-0.5, 0.5, (count, 3)), np.zeros((count, 3))
    axis, sign = rng.integers(3, size=count), rng.choice([-1.0, 1.0], count)
    points[np.arange(count), axis] = 0.5 * sign
    normals[np.arange(count), axis] = sign
    return points * [2.0, 1.5, 1.0], normals


@pytest.mark.parametrize("plane", [True, False])
def test_sparse_icp_ignores_outliers_that_break_plain_icp(plane: bool) -> None:
    rng = np.random.default_rng(0)
    target, normals = box_surface(3000, rng)
    truth = se3.exp(np.array([0.05, -0.03, 0.06, 0.04, -0.05, 0.03]))
    inliers = se3.transform(se3.inverse(truth), target[:500])
    clump = rng.uniform(-0.2, 0.2, (250, 3)) + [1.4, 0.0, 0.2]
    source = np.concatenate([inliers, clump])
    found = sparse_icp(source, target, normals if plane else None, np.eye(4))
    clouds = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(p)) for p in (source, target)]
    plain = registration.registration_icp(*clouds, 10.0, np.eye(4)).transformation
    assert max(errors(truth, found)) < 0.3
    assert errors(truth, found)[1] < 0.005
    assert errors(truth, plain)[1] > 0.05


@pytest.mark.parametrize("mu", [2.0, 10.0, 1e3])
def test_shrink_minimises_the_p_norm_with_its_penalty(mu: float) -> None:
    lengths = np.linspace(0.0, 2.0, 41)
    p = Parameters().p
    shrunk = shrink(lengths[:, None], mu, p)[:, 0]
    grid = np.linspace(0.0, 2.0, 20001)
    cost = grid**p + 0.5 * mu * (grid - lengths[:, None]) ** 2
    achieved = shrunk**p + 0.5 * mu * (shrunk - lengths) ** 2
    assert (achieved <= cost.min(axis=1) + 0.01).all()
    assert (shrunk == 0.0).any() and (shrunk > 0.0).any()


@cache
def planted() -> tuple[Base, Sample, Array, Array]:
    """A base, a moved and thinned copy of its points among others, and the copy's base points."""
    rng = np.random.default_rng(3)
    points, normals = box_surface(400, rng)
    base = wide_base(Sample.of(points, normals), 1.6, 0.02, rng)
    assert base is not None
    truth = se3.exp(np.array([0.4, -1.0, 0.7, 1.0, 2.0, -0.5]))
    strangers = rng.uniform(-1.0, 1.0, (100, 3)), box_surface(100, rng)[1]
    clutter = np.concatenate([points, strangers[0]]), np.concatenate([normals, strangers[1]])
    moved = se3.transform(se3.inverse(truth), clutter[0])
    copy = Sample.of(moved, se3.rotate(se3.inverse(truth), clutter[1]))
    wanted = [int(np.linalg.norm(points - p, axis=1).argmin()) for p in base.points]
    return base, copy, np.array(wanted), truth


def test_a_base_is_wide_coplanar_and_its_diagonals_cross() -> None:
    base = planted()[0]
    a, b, c, d = base.points
    sides = np.linalg.norm(base.points[:, None] - base.points, axis=-1)
    assert 0.8 < sides.max() < 2.0 * 1.6
    assert sides[np.triu_indices(4, 1)].min() > 0.2 * 1.6
    crossing = a + base.ratios[0] * (b - a), c + base.ratios[1] * (d - c)
    assert np.linalg.norm(crossing[0] - crossing[1]) < 0.03
    assert ((base.ratios > 0) & (base.ratios < 1)).all()


def test_congruent_sets_hold_the_true_one_and_only_congruent_ones() -> None:
    base, copy, wanted, _ = planted()
    sets = congruent_sets(base, copy, 0.02)
    assert (sets == wanted).all(axis=1).any()
    assert len(sets) < 2000
    for side in (0, 2):
        ends = copy.points[sets[:, side]], copy.points[sets[:, side + 1]]
        expected = np.linalg.norm(base.points[side] - base.points[side + 1])
        lengths = np.linalg.norm(ends[0] - ends[1], axis=1)
        np.testing.assert_allclose(lengths, expected, atol=0.02 + 1e-9)


def test_the_largest_common_set_is_the_true_pose_and_is_counted_right() -> None:
    _, copy, _, truth = planted()
    target = se3.transform(truth, copy.points[:400])
    rng = np.random.default_rng(0)
    others = se3.exp(rng.normal(scale=0.5, size=(20, 6))) @ truth
    poses = np.concatenate([others, truth[None]])
    winner = largest(poses, copy.points, Vicinity.of(target, 0.05), 100)
    assert winner is not None and winner[0] == len(others)
    distance, _ = KDTree(target).query(se3.transform(truth, copy.points))
    assert (distance < 0.02).sum() <= winner[1] <= (distance < 0.08).sum()
    assert largest(poses[:-1], copy.points, Vicinity.of(target, 0.05), 400) is None


def test_the_authors_binary_is_run_where_there_is_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth = views()[2]
    rows = "\n".join(" ".join(f"{x:.6f}" for x in row) for row in truth)
    tool = tmp_path / "Super4PCS"
    tool.write_text(
        '#!/bin/sh\ntest -s "$2" -a -s "$3" || exit 1\nfor last; do :; done\n'
        f'printf "VERSION\\t=\\t1\\nMATRIX\\t=\\n{rows}\\n" > "$last"\n'
    )
    tool.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    monkeypatch.setattr("benchmark.methods.four_points._search", None)
    source, target, _, _ = views()
    method = FourPoints()
    (candidate,) = method.match(method.prepare(source), method.prepare(target)).candidates
    rotation_deg, shift_m = errors(truth, candidate.target_T_source)
    assert rotation_deg < 2.0 and shift_m < 0.05
