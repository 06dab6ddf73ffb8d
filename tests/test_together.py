"""What two scans of an L-shaped room say of any pose: the potential, proposals, candidates."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest
from box_scans import scan_of
from scipy import ndimage

from benchmark.planted_graphs import UP_IN_CAMERA
from fewview.completion.layout.grid import CELLS, CLASSES, FREE, UNKNOWN, WALL, cell_centres
from fewview.geometry import se3
from fewview.matching.prepared import PreparedScan, aligned, prepare
from fewview.probability import ProbabilityModel
from fewview.together import (
    LEAST,
    PROPOSED,
    VOTES,
    PotentialModel,
    Together,
    pair_quantities,
    potential_from,
    shipped_potential,
)
from fewview.types import (
    Array,
    BoolArray,
    CandidateOrigin,
    CompletedLayout,
    CompletedRoom,
    Levelling,
    Representation,
)

CORNERS = np.array([[0.0, 0.0], [4.5, 0.0], [4.5, 2.0], [2.5, 2.0], [2.5, 3.5], [0.0, 3.5]])
STANDS = np.array([[1.0, 1.0, 1.4], [2.0, 1.5, 1.2], [3.5, 1.0, 1.6], [1.5, 2.5, 1.3]])
"""Where cameras stand, metres; of each one the level frame has a quarter turn more."""
PITCHES = np.array([0.0, 0.3, -0.2, 0.1])
FEATURES = (VOTES, "aligner", "overlap", "residual", "distance")
WEIGHTS = np.array([1.0, 0.5, 3.0, -2.0, 0.1])


def in_room(places: Array) -> BoolArray:
    """(...) which of (..., 2) places of the floor plan are in the room."""
    x, y = places[..., 0], places[..., 1]
    return np.asarray((x > 0) & (y > 0) & (x < 4.5) & (y < 3.5) & ((x < 2.5) | (y < 2.0)))


def world_T_level(scan: int) -> Array:
    yaw = np.array([0.0, 0.0, scan * np.pi / 2])
    return se3.pose(se3.rotation_exp(yaw), STANDS[scan])


def level_T_scan(scan: int) -> Array:
    pitch = se3.rotation_exp(np.array([PITCHES[scan], 0.0, 0.0]))
    return se3.pose(UP_IN_CAMERA @ pitch, np.zeros(3))


def walls(rng: np.random.Generator) -> tuple[Array, Array]:
    """Points and normals of the walls, counter-clockwise around the room."""
    points, normals = [], []
    for start, end in zip(CORNERS, np.roll(CORNERS, -1, axis=0), strict=True):
        along = rng.uniform(size=(300, 1))
        places = start + along * (end - start)
        points.append(np.column_stack([places, rng.uniform(0.0, 2.5, 300)]))
        inward = np.array([start[1] - end[1], end[0] - start[0], 0.0])
        normals.append(np.tile(inward / np.linalg.norm(inward), (300, 1)))
    return np.concatenate(points), np.concatenate(normals)


def completed_layout(scan: int) -> CompletedLayout:
    """The true layout; what lies ahead of the camera was observed."""
    level = np.concatenate([cell_centres().reshape(-1, 2), np.zeros((CELLS * CELLS, 1))], axis=1)
    free = in_room(se3.transform(world_T_level(scan), level)[:, :2]).reshape(CELLS, CELLS)
    wall = ndimage.binary_dilation(free, np.ones((3, 3))) & ~free
    classes = np.where(free, FREE, np.where(wall, WALL, UNKNOWN)).astype(np.uint8)
    return CompletedLayout(
        level_T_scan=level_T_scan(scan),
        probabilities=np.stack([classes == k for k in range(len(CLASSES))]).astype(np.float32),
        classes=classes,
        descriptors=np.zeros((CELLS, CELLS, 0), np.float32),
        confidence=np.ones((CELLS, CELLS), np.float32),
        observed=cell_centres()[..., 1] > 0.0,
        floor=np.array([0.0, 0.0, 1.0, -STANDS[scan, 2]]),
    )


@pytest.fixture(scope="module")
def truth() -> Array:
    """(4, 4, 4) world_T_scan."""
    return np.stack([world_T_level(k) @ level_T_scan(k) for k in range(4)])


@pytest.fixture(scope="module")
def scans(truth: Array) -> list[PreparedScan]:
    rng = np.random.default_rng(0)
    out = []
    for k, pose in enumerate(truth):
        seen = scan_of(pose, *walls(rng))
        room = CompletedRoom(seen.room.ring, layout=completed_layout(k))
        levelling = Levelling(level_T_scan(k)[:3, :3], 0.9, True, -STANDS[k, 2])
        out.append(prepare(replace(seen, room=room, levelling=levelling)))
    return out


def weighing(features: tuple[str, ...] = FEATURES, weights: Array = WEIGHTS) -> PotentialModel:
    """A potential that is a weighted sum of a few quantities."""
    d = len(features)
    nothing = np.zeros((0, d)), np.zeros(0), np.zeros(0)
    pair = ProbabilityModel(features, np.zeros(d), np.ones(d), weights, 0.25, *nothing)
    return PotentialModel(pair, join=-3.0, drawn=0.5, typical=-4.0)


@pytest.fixture
def fresh(scans: list[PreparedScan]) -> Callable[[], Together]:
    return lambda: Together(scans.__getitem__, weighing())


def way(truth: Array, source: int, target: int) -> Array:
    return se3.inverse(truth[target]) @ truth[source]


def around(truth: Array, source: int, target: int, count: int = 6) -> Array:
    """The true pose and others, ever further from it."""
    off = np.array([0.0, 0.05, 0.0, 0.1, 0.0, 0.15]) * np.arange(count)[:, None]
    return way(truth, source, target) @ se3.exp(off)


# The potential


def test_the_potential_is_the_models_of_the_pairs_quantities(
    fresh: Callable[[], Together], scans: list[PreparedScan], truth: Array
) -> None:
    poses, votes = around(truth, 0, 1), np.linspace(0.0, 2.0, 6)
    found = fresh().potential(0, 1, poses, votes)
    alignment = aligned(scans[0], scans[1])
    assert alignment is not None
    quantities = pair_quantities(scans[0], scans[1], poses, alignment) | {VOTES: votes}
    f = np.clip(np.stack([quantities[name] for name in FEATURES], axis=1), -4.0, 4.0)
    np.testing.assert_allclose(found, f @ WEIGHTS + 0.25, atol=1e-3)
    assert found[0] - votes[0] == max(found - votes)
    assert fresh().join == -3.0


def test_the_order_of_questions_does_not_matter(
    fresh: Callable[[], Together], truth: Array
) -> None:
    poses = around(truth, 0, 1)
    nearly = poses @ se3.exp(np.array([0.0, 0.0, 0.0, 3e-6, 0.0, 0.0]))
    votes = np.zeros(6)
    one, other = fresh(), fresh()
    first = one.potential(0, 1, poses, votes)
    np.testing.assert_array_equal(one.potential(0, 1, poses, votes), first)
    np.testing.assert_array_equal(one.potential(0, 1, poses[::-1], votes)[::-1], first)
    backward = [other.potential(0, 1, poses[k : k + 1], votes[:1])[0] for k in range(5, -1, -1)]
    np.testing.assert_allclose(backward[::-1], first, rtol=1e-12)
    both = fresh().potential(0, 1, np.concatenate([nearly, poses]), np.zeros(12))
    np.testing.assert_allclose(both[6:], one.potential(0, 1, poses, votes), rtol=1e-12)
    np.testing.assert_allclose(both[:6], fresh().potential(0, 1, nearly, votes), rtol=1e-12)


def test_votes_are_no_property_of_the_pose(fresh: Callable[[], Together], truth: Array) -> None:
    together, poses = fresh(), around(truth, 2, 3, 2)
    silent = together.potential(2, 3, poses, np.zeros(2))
    np.testing.assert_allclose(
        together.potential(2, 3, poses, np.array([1.5, 0.5])) - silent, [1.5, 0.5], atol=1e-12
    )
    np.testing.assert_array_equal(together.potential(2, 3, poses, np.zeros(2)), silent)


def test_a_pose_is_looked_at_once(scans: list[PreparedScan], truth: Array) -> None:
    looked: list[int] = []

    def scan(index: int) -> PreparedScan:
        looked.append(index)
        return scans[index]

    together, poses = Together(scan, weighing()), around(truth, 0, 2)
    together.potential(0, 2, poses[:4], np.zeros(4))
    before = len(looked)
    together.potential(0, 2, poses[1:4], np.zeros(3))
    assert len(looked) == before > 0
    together.potential(0, 2, poses, np.zeros(6))
    assert len(looked) > before


# Proposals


def errors(found: Array, expected: Array) -> tuple[Array, Array]:
    turn, shift = se3.distance(found, expected)
    return np.degrees(turn), shift


@pytest.mark.parametrize(("source", "target"), [(0, 1), (2, 0), (3, 2)])
def test_the_true_motion_is_proposed_among_others(
    fresh: Callable[[], Together], truth: Array, source: int, target: int
) -> None:
    frame = {i: truth[i] for i in range(4)}
    found = fresh().overlay({source: frame[source]}, {target: frame[target]}).proposals()
    assert found.shape == (PROPOSED, 4, 4)
    turn, shift = errors(found @ truth[source], truth[source])
    assert ((turn < 1.0) & (shift < 0.3)).any()
    np.testing.assert_allclose((found @ truth[source])[:, 2, 3], STANDS[source, 2], atol=1e-3)
    assert (turn > 15.0).any() or (shift > 0.5).any()


@pytest.mark.parametrize(("moving", "fixed"), [((0,), (2, 3)), ((1, 2), (0,)), ((0, 3), (1, 2))])
def test_groups_are_laid_over_groups_whatever_their_frames(
    fresh: Callable[[], Together], truth: Array, moving: tuple[int, ...], fixed: tuple[int, ...]
) -> None:
    one, other = ({i: truth[i] for i in group} for group in (moving, fixed))
    found = fresh().overlay(one, other).proposals()
    turn, shift = errors(found @ truth[moving[0]], truth[moving[0]])
    assert ((turn < 1.0) & (shift < 0.3)).any()
    a = se3.exp(np.array([0.4, -0.2, 1.0, 3.0, 1.0, -2.0]))
    b = se3.exp(np.array([-0.3, 0.6, -2.0, 0.0, 5.0, 1.0]))
    moved = fresh().overlay(in_frame(a, one), in_frame(b, other)).proposals()
    np.testing.assert_allclose(moved, b @ found @ se3.inverse(a), atol=1e-3)


def in_frame(motion: Array, poses: Mapping[int, Array]) -> dict[int, Array]:
    return {i: motion @ pose for i, pose in poses.items()}


def test_a_group_is_drawn_as_its_scans_stand(fresh: Callable[[], Together], truth: Array) -> None:
    """Apart, the scans show a larger room than together."""
    off = se3.pose(np.eye(3), np.array([1.5, 0.0, 0.0])) @ truth[3]
    groups = ({1: truth[1]}, {1: truth[1], 3: truth[3]}, {1: truth[1], 3: off})
    alone, beside, apart = (fresh().overlay({0: truth[0]}, g).proposals() for g in groups)
    assert np.abs(alone - beside).max() > 1e-3
    best = [errors(found @ truth[0], truth[0])[1].min() for found in (beside, apart)]
    assert best[0] < best[1]


def test_what_is_drawn_speaks_for_its_proposals(
    fresh: Callable[[], Together], truth: Array
) -> None:
    overlay = fresh().overlay({0: truth[0]}, {i: truth[i] for i in (1, 2, 3)})
    far = se3.pose(np.eye(3), np.array([2.0, -1.5, 0.0]))
    motions = np.stack([np.eye(4), far, overlay.proposals()[0]])
    found = overlay.log_odds(motions)
    np.testing.assert_allclose(found, 0.5 * (overlay.log_mass(motions) + 4.0))
    assert found[2] > 0.0 and found[2] >= found[0] > found[1] >= 0.5 * (LEAST + 4.0)
    a, b = (se3.exp(np.array([0.4, -0.2, s, 3.0, s, -2.0])) for s in (1.0, -2.0))
    moved = fresh().overlay({0: a @ truth[0]}, {i: b @ truth[i] for i in (1, 2, 3)})
    np.testing.assert_allclose(moved.log_odds(b @ motions @ se3.inverse(a)), found, atol=1e-2)


def test_drawings_of_two_scans_and_of_many_add_nothing(
    fresh: Callable[[], Together], truth: Array, monkeypatch: pytest.MonkeyPatch
) -> None:
    overlay = fresh().overlay({0: truth[0]}, {1: truth[1]})
    np.testing.assert_array_equal(overlay.log_odds(overlay.proposals()), 0.0)
    monkeypatch.setattr("fewview.together.MOST_DRAWN", 3)
    overlay = fresh().overlay({0: truth[0]}, {i: truth[i] for i in (1, 2, 3)})
    np.testing.assert_array_equal(overlay.log_odds(overlay.proposals()), 0.0)


# Candidates


def test_a_candidate_holds_what_was_measured_of_it(
    fresh: Callable[[], Together], scans: list[PreparedScan], truth: Array
) -> None:
    together, pose = fresh(), way(truth, 0, 3)
    found = together.candidate(0, 3, pose, 2, 0.7)
    assert (found.rank, found.origin, found.probability) == (2, CandidateOrigin.TOGETHER, 0.7)
    assert not found.told and not found.vetoed
    np.testing.assert_array_equal(found.target_T_source, pose)
    assert found.score == together.potential(0, 3, pose[None], np.zeros(1))[0]
    assert found.evidence.overlap > 0.5 and found.evidence.residual_m < 0.01
    assert found.evidence.support == dict.fromkeys(Representation, 0)
    apart = together.candidate(0, 3, around(truth, 0, 3)[5], 2, 0.7)
    assert apart.evidence.overlap < found.evidence.overlap
    assert (np.linalg.eigvalsh(found.covariance) > 0.0).all()


# The model


def test_a_model_is_read_from_what_is_stored() -> None:
    stored = {
        "features": [VOTES, "overlap"],
        "mean": [1.0, 0.5],
        "scale": [2.0, 0.25],
        "coefficients": [0.5, 1.0],
        "inner": [[0.0, 1.0]],
        "inner_offsets": [0.0],
        "outer": [2.0],
        "intercept": -0.5,
        "join": -4,
        "drawn": 0.5,
        "typical": -3,
    }
    model = potential_from(stored)
    assert (model.join, model.drawn, model.typical) == (-4.0, 0.5, -3.0)
    [found] = model.pair.logits_of(model.pair.standard(np.array([[3.0, 0.75]])))
    assert found == pytest.approx(0.5 + 1.0 - 0.5 + 2.0 * np.tanh(1.0))


def test_the_shipped_potential_weighs_what_is_measured(
    scans: list[PreparedScan], truth: Array
) -> None:
    text = (resources.files("fewview") / "weights" / "potential.json").read_text()
    made = json.loads(text)["made"]
    assert made["by"] == "scripts/fit_potential.py"
    model = shipped_potential()
    assert model.join < 0.0 < model.drawn and (model.pair.scale > 0).all()
    alignment = aligned(scans[0], scans[1])
    assert alignment is not None
    found = pair_quantities(scans[0], scans[1], around(truth, 0, 1), alignment)
    foreseen = {"met", "inside", "through", "foreseen"}
    assert {*found, *foreseen, VOTES} >= {*model.pair.features}
    assert all(len(values) == 6 for values in found.values())
