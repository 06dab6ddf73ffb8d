"""Scans that invite confident mistakes: two rooms in one folder, halves that look alike."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from benchmark.ambiguity import look_alike, score, two_rooms, wrong_scans
from benchmark.corridors import Likeness, corridor, corridor_views
from benchmark.planted_graphs import (
    Noise,
    candidate,
    pair_result,
    room_poses,
    shaken,
    upright_levelling,
)
from fewview import pipeline
from fewview.config import GlobalConfig
from fewview.geometry import se3
from fewview.global_stage import solve
from fewview.synthetic import kinect, render
from fewview.synthetic.camera import overlap, viewpoint
from fewview.types import Array, GlobalSolution, PairResult

HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
EACH = 3


def solved(poses: Array, pairs: list[PairResult]) -> GlobalSolution:
    names = [f"scan-{i}" for i in range(len(poses))]
    return solve(names, [upright_levelling(pose) for pose in poses], pairs, GlobalConfig(), 0)


def planted(seed: int, twin: float, other: float) -> tuple[Array, list[PairResult]]:
    """Two groups of scans that hold together well.

    Args:
        seed: of the poses.
        twin: probability, in every pair between the groups, of the true pose, and again of that
            with the second group turned about the middle.
        other: probability of a pose from nowhere in these pairs.
    """
    rng = np.random.default_rng(seed)
    poses = room_poses(rng, 2 * EACH)
    nowhere = room_poses(rng, 4 * EACH * EACH)
    pairs = []
    for s, t in itertools.combinations(range(2 * EACH), 2):
        true = se3.inverse(poses[t]) @ poses[s]
        motions, probabilities = [true], [0.9]
        if s < EACH <= t:
            turned = se3.inverse(HALF_TURN @ poses[t]) @ poses[s]
            random = se3.inverse(nowhere[2 * len(pairs) % len(nowhere)]) @ nowhere[len(pairs)]
            motions, probabilities = [true, turned, random], [twin, twin, other]
        made = [
            candidate(rank, shaken(rng, motion, Noise()), p)
            for rank, (motion, p) in enumerate(zip(motions, probabilities, strict=True))
        ]
        pairs.append(pair_result(s, t, made))
    return poses, pairs


@pytest.mark.parametrize("seed", range(3))
def test_planted_rooms_stay_apart(seed: int) -> None:
    """Nine wrong links of 0.3 between the groups, no two of which agree."""
    poses, pairs = planted(seed, twin=0.0, other=0.3)
    solution = solved(poses, pairs)
    assert [c.scans for c in solution.components] == [(0, 1, 2), (3, 4, 5)]


@pytest.mark.parametrize("seed", range(6))
def test_planted_halves_with_two_places_are_doubted(seed: int) -> None:
    """Nine pairs say the same of both places: together they are no surer than one."""
    poses, pairs = planted(seed, twin=0.45, other=0.0)
    solution = solved(poses, pairs)
    assert min(p.probability for p in solution.placements) < 0.8
    other = solution.alternatives[0]
    assert 0.5 < other.odds <= 1.0
    assert {place.scan for place in other.places} in ({0, 1, 2}, {3, 4, 5})


def test_wrong_scans_are_those_that_leave_the_majority() -> None:
    truth = room_poses(np.random.default_rng(0), 6)
    found = list(truth)
    found[1] = HALF_TURN @ truth[1]
    assert wrong_scans(truth, [0, 0, 0, 0, 1, 1], found).tolist() == [False, True] + 4 * [False]
    found[5] = HALF_TURN @ truth[5]
    assert wrong_scans(truth, [0, 0, 0, 0, 1, 1], found).tolist()[4:] == [True, True]
    assert not wrong_scans(truth, [0, None, 0, 0, None, None], found).any()


@pytest.mark.parametrize("likeness", Likeness)
def test_what_one_half_shows_is_in_the_other_too(likeness: Likeness) -> None:
    room, camera = corridor(1, likeness), kinect(64, 48)
    second_T_first = HALF_TURN if likeness is Likeness.TURNED else np.diag([-1.0, 1.0, 1.0, 1.0])
    flip = 1 if likeness is Likeness.TURNED else -1
    pose = corridor_views(room, 1, 0, 0, camera)[0]
    twin = second_T_first @ pose @ np.diag([flip, 1.0, 1.0, 1.0])
    one, other = render(room, pose, camera), render(room, twin, camera)
    np.testing.assert_allclose(one.depth, other.depth[:, ::flip], atol=1e-3)
    difference = np.abs(one.colour.astype(float) - other.colour[:, ::flip])
    assert np.median(difference) < 3.0


def test_views_of_one_half_see_nothing_of_the_other() -> None:
    room, camera = corridor(0, Likeness.TURNED), kinect(64, 48)
    poses = corridor_views(room, 2, 0, 0, camera)
    views = [viewpoint(room, pose, camera) for pose in poses]
    assert overlap(room, views[0], views[1], camera) > 0.2
    for one, other in itertools.product(views[:2], views[2:]):
        assert overlap(room, one, other, camera) < 0.05


@pytest.mark.slow
def test_scans_of_two_rooms_come_out_as_two_components() -> None:
    told = score(mixed := two_rooms((2, 3), 4, 0), pipeline.reconstruct(mixed.scans))
    assert [set(component) for component in told["components"]] in ([{"A"}, {"B"}], [{"B"}, {"A"}])
    assert not told["wrong"]


@pytest.mark.slow
def test_mirrored_halves_are_not_laid_over_each_other_with_confidence() -> None:
    told = score(
        mixed := look_alike(Likeness.MIRRORED, 3, 0, 100), pipeline.reconstruct(mixed.scans)
    )
    assert len(told["components"]) == 2
    assert not told["wrong"]
