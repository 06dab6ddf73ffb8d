"""Fine-to-Coarse on a camera that turns in generated rooms, with drift added to its motions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from benchmark.backends.fine_to_coarse import equations, fine_to_coarse
from benchmark.backends.fine_to_coarse.correspondences import PointPairs
from benchmark.backends.fine_to_coarse.equations import State, Term, Tie
from benchmark.backends.fine_to_coarse.structures import Planes, Relation, cluster, relations
from benchmark.backends.fine_to_coarse.views import view_of
from benchmark.methods.interface import Candidate
from fewview.evaluation.gauge import AbsoluteErrors, absolute_errors
from fewview.geometry import se3
from fewview.synthetic import kinect, make_room, render, sample_views, split_seed
from fewview.types import Array, Frame

SEVERAL_PLANES = (7, 10)
"""Validation rooms where every view shows six planes or more, so that nothing can slide."""
FRAMES = 8
TURN = np.radians(10.0)
DRIFT = np.array([0.01, 0.03, -0.01, 0.03, -0.02, 0.03])
Local = dict[tuple[int, int], Candidate]


@dataclass(frozen=True)
class Sequence:
    """Frames with their true poses, and their motions as a drifting tracker gives them."""

    frames: list[Frame]
    truth: Array
    local: Local

    def errors(self, poses: list[Array]) -> AbsoluteErrors:
        return absolute_errors(self.truth, poses)


@cache
def sequence(room_index: int) -> Sequence:
    room = make_room(split_seed("validation", room_index))
    camera = kinect(160, 120)
    start = sample_views(room, 1, 0, "random", camera)[0]
    step = se3.exp(np.array([0.0, TURN, 0.0, 0.03, 0.0, 0.02]))
    truth = [start]
    for _ in range(FRAMES - 1):
        truth.append(truth[-1] @ step)
    rng = np.random.default_rng(room_index)
    frames = [render(room, pose, camera, rng) for pose in truth]
    drifting = se3.exp(DRIFT) @ se3.inverse(step)
    local = {(i, i + 1): Candidate(drifting) for i in range(FRAMES - 1)}
    return Sequence(frames, np.array(truth), local)


def concatenated(local: Local) -> list[Array]:
    poses = [np.eye(4)]
    for i in range(FRAMES - 1):
        poses.append(poses[-1] @ se3.inverse(local[i, i + 1].target_T_source))
    return poses


@cache
def registered(room_index: int) -> list[Array]:
    s = sequence(room_index)
    return fine_to_coarse(s.frames, s.local)


@pytest.mark.parametrize("room_index", SEVERAL_PLANES)
def test_drift_is_reduced(room_index: int) -> None:
    s = sequence(room_index)
    before, after = s.errors(concatenated(s.local)), s.errors(registered(room_index))
    assert after.rotation_deg.mean() < 0.5 * before.rotation_deg.mean()
    assert after.translation_m.mean() < 0.5 * before.translation_m.mean()


def test_true_motions_are_kept() -> None:
    s = sequence(SEVERAL_PLANES[0])
    motions = {(i, j): se3.inverse(s.truth[j]) @ s.truth[i] for i, j in s.local}
    poses = fine_to_coarse(s.frames, {pair: Candidate(pose) for pair, pose in motions.items()})
    after = s.errors(poses)
    assert after.rotation_deg.mean() < 0.5
    assert after.translation_m.mean() < 0.02


def test_same_bytes_again() -> None:
    s = sequence(SEVERAL_PLANES[0])
    again = np.stack(fine_to_coarse(s.frames, s.local))
    assert again.tobytes() == np.stack(registered(SEVERAL_PLANES[0])).tobytes()


def test_the_first_frame_is_the_world() -> None:
    np.testing.assert_allclose(registered(SEVERAL_PLANES[0])[0], np.eye(4), atol=1e-12)


def test_a_missing_motion_leaves_the_others() -> None:
    s = sequence(SEVERAL_PLANES[0])
    gap = 3
    local = {pair: found for pair, found in s.local.items() if pair != (gap, gap + 1)}
    poses = fine_to_coarse(s.frames, local)
    assert len(poses) == FRAMES and np.isfinite(poses).all()
    for part in (slice(None, gap + 1), slice(gap + 1, None)):
        errors = absolute_errors(s.truth[part], poses[part])
        assert errors.rotation_deg.mean() < 3.0
        assert errors.translation_m.mean() < 0.1


def test_unconnected_frames_without_points_keep_their_pose() -> None:
    s = sequence(SEVERAL_PLANES[0])
    empty = [replace(frame, depth=np.zeros_like(frame.depth)) for frame in s.frames[:3]]
    np.testing.assert_allclose(fine_to_coarse(empty, {}), np.tile(np.eye(4), (3, 1, 1)), atol=1e-9)


def test_frames_without_any_plane_keep_the_motions() -> None:
    s = sequence(SEVERAL_PLANES[0])
    rng = np.random.default_rng(0)
    rough = [
        replace(frame, depth=rng.uniform(1.0, 4.0, frame.depth.shape).astype(np.float32))
        for frame in s.frames[:3]
    ]
    assert not any(len(view_of(frame).planes) for frame in rough)
    poses = fine_to_coarse(rough, {pair: s.local[pair] for pair in ((0, 1), (1, 2))})
    rotation, translation = se3.distance(np.stack(poses), np.stack(concatenated(s.local)[:3]))
    assert rotation.max() < np.radians(1.0) and translation.max() < 0.02


def test_one_frame_is_the_world() -> None:
    poses = fine_to_coarse(sequence(SEVERAL_PLANES[0]).frames[:1], {})
    np.testing.assert_allclose(poses, np.eye(4)[None], atol=1e-12)


def planes(*rows: tuple[float, float, float]) -> Planes:
    """Walls facing -x, by their x, their turn about z in degrees and their arc length."""
    x, degrees, arc = np.array(rows).T
    angle = np.radians(degrees)
    normals = np.stack([-np.cos(angle), -np.sin(angle), np.zeros_like(x)], axis=1)
    centres = np.stack([x, np.zeros_like(x), np.zeros_like(x)], axis=1)
    return Planes(centres, normals, np.full(len(x), 100.0), arc, arc)


def test_coplanar_planes_of_a_window_become_one_structure() -> None:
    same, shifted, turned, late = (
        (0.05, 3.0, 1.0),
        (0.4, 0.0, 1.0),
        (0.0, 40.0, 1.0),
        (0.0, 0.0, 5.0),
    )
    found, owner = cluster(planes((0.0, 0.0, 0.0), same, shifted, turned, late), 3.0)
    assert owner.tolist() == [0, 0, -1, -1, -1]
    np.testing.assert_allclose(found.centres, [[0.025, 0.0, 0.0]])
    assert (found.first[0], found.last[0], found.counts[0]) == (0.0, 1.0, 200.0)


def test_a_larger_window_joins_what_a_smaller_one_does_not() -> None:
    walls = planes((0.0, 0.0, 0.0), (0.0, 0.0, 5.0))
    assert cluster(walls, 3.0)[1].tolist() == [-1, -1]
    assert cluster(walls, 6.0)[1].tolist() == [0, 0]


def test_relations_are_found_within_their_tolerance() -> None:
    walls = planes((0.0, 0.0, 0.0), (1.0, 5.0, 0.0), (2.0, 88.0, 0.0), (3.0, 180.0, 0.0))
    found = {(r.a, r.b): r.cosine for r in relations(walls, 3.0)}
    assert found == {(0, 1): 1, (0, 2): 0, (0, 3): -1, (1, 2): 0, (1, 3): -1, (2, 3): 0}
    assert not relations(planes((0.0, 0.0, 0.0), (0.0, 45.0, 0.0)), 3.0)
    assert not relations(planes((0.0, 0.0, 0.0), (0.0, 0.0, 7.0)), 3.0)


def unit(rng: np.random.Generator, count: int) -> Array:
    rows = rng.normal(size=(count, 3))
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def terms(state: State) -> tuple[Term, ...]:
    """Every kind of term with arbitrary data."""
    rng = np.random.default_rng(1)
    i, j, structure = rng.integers(2, size=5), 1 - rng.integers(2, size=5), rng.integers(2, size=5)
    pairs = PointPairs(
        i, rng.normal(size=(5, 3)), j, rng.normal(size=(5, 3)), unit(rng, 5), np.ones(5), np.ones(5)
    )
    motion = se3.exp(rng.normal(size=6))
    related = [Relation(0, 1, cosine, 0.5) for cosine in (1, 0, -1)]
    return (
        equations.point_to_plane(state, pairs, 1.0),
        equations.point_on_structure(state, i, pairs.points, structure, 1.0),
        equations.related(state, related, 1.0),
        equations.tied(state, [Tie(0, 1, motion, 2.0)], 1.0),
    )


def test_jacobians_are_the_derivatives() -> None:
    rng = np.random.default_rng(0)
    poses = se3.exp(rng.normal(size=(2, 6)))
    state = State(poses, rng.normal(size=(2, 3)), unit(rng, 2), rng.normal(size=2))
    size, h = 18, 1e-6
    steps = np.eye(size) * h
    ahead, back = [terms(state.moved(s)) for s in steps], [terms(state.moved(-s)) for s in steps]
    for kind, term in enumerate(terms(state)):
        jacobian = np.zeros((len(term.residual), size))
        np.add.at(jacobian, (np.arange(len(jacobian))[:, None], term.columns), term.jacobian)
        differences = zip(ahead, back, strict=True)
        expected = [(a[kind].residual - b[kind].residual) / (2 * h) for a, b in differences]
        np.testing.assert_allclose(jacobian, np.array(expected).T, atol=1e-6)
