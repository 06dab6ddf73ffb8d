"""The discrete stage: its objective, its search against brute force, its probabilities."""

from __future__ import annotations

import copy
import itertools

import numpy as np
import pytest

from benchmark.inference.enumeration import best_forest, forests
from benchmark.planted_graphs import Noise, candidate, pair_result, planted_graph, room_poses
from fewview.config import GlobalConfig
from fewview.errors import ConfigError
from fewview.geometry import se3
from fewview.global_stage import discrete
from fewview.global_stage.belief import drop_doubtful, judge
from fewview.global_stage.comparison import distinct, moved_scans, says_new
from fewview.global_stage.model import build
from fewview.global_stage.placement import State, agreement_now, gain_matrix, objective, options
from fewview.types import Array, PairResult

CONFIG = GlobalConfig()


def linked(poses: Array, links: dict[tuple[int, int], float]) -> list[PairResult]:
    """Exact candidates of given probabilities."""
    return [
        pair_result(s, t, [candidate(0, se3.inverse(poses[t]) @ poses[s], p)])
        for (s, t), p in links.items()
    ]


def believed(links: dict[tuple[int, int], float], scans: int, config: GlobalConfig) -> Array:
    poses = room_poses(np.random.default_rng(5), scans)
    problem = build(scans, linked(poses, links), config)
    [state] = discrete.search(problem, config.restarts, 0)
    return judge(problem, state).probability


@pytest.mark.parametrize("seed", range(16))
def test_search_reaches_the_best_of_all_forests(seed: int) -> None:
    noise = Noise(6.0, 0.2) if seed % 2 else Noise()
    _, pairs = planted_graph(seed, 4, 2, link_rate=0.9, noise=noise)
    problem = build(4, pairs, CONFIG)
    [found] = discrete.search(problem, CONFIG.restarts, seed)
    best = objective(problem, best_forest(problem, 0))
    assert objective(problem, found) >= best - 1e-6


def test_runners_up_are_those_of_all_forests() -> None:
    short = []
    for seed in range(6):
        _, pairs = planted_graph(seed, 4, 2, link_rate=0.9, lookalike=0.5)
        problem = build(4, pairs, CONFIG)
        ranked = sorted(forests(problem), key=lambda state: -objective(problem, state))
        expected = [objective(problem, state) for state in distinct(problem, ranked, 4)]
        found = [objective(problem, s) for s in discrete.search(problem, CONFIG.restarts, seed, 4)]
        assert found == sorted(found, reverse=True)
        short += [e - f for e, f in zip(expected, found, strict=True)]
    assert max(short) < 0.1
    assert np.mean(np.array(short) < 1e-6) > 0.9


def test_the_best_does_not_depend_on_how_many_are_asked_for() -> None:
    _, pairs = planted_graph(3, 7, 3)
    problem = build(7, pairs, CONFIG)
    [one] = discrete.search(problem, 4, 0)
    several = discrete.search(problem, 4, 0, 4)
    assert objective(problem, several[0]) >= objective(problem, one)
    assert len(several) == 4
    for k, state in enumerate(several):
        assert says_new(problem, state, several[:k])


def test_taking_scans_apart_says_nothing_new() -> None:
    poses = room_poses(np.random.default_rng(0), 3)
    problem = build(3, linked(poses, {(0, 1): 0.8, (1, 2): 0.8, (0, 2): 0.8}), CONFIG)
    [whole] = discrete.search(problem, 4, 0, 3)
    less = whole.copy()
    less.detach(np.arange(3) == 2)
    assert not says_new(problem, less, [whole])
    assert says_new(problem, whole, [less])


def test_moved_scans_are_the_smaller_side() -> None:
    poses = room_poses(np.random.default_rng(0), 6)
    links = dict.fromkeys(itertools.combinations(range(6), 2), 0.8)
    problem = build(6, linked(poses, links), CONFIG)
    [state] = discrete.search(problem, 4, 0)
    other = state.copy()
    other.move(np.isin(np.arange(6), [1, 4]), se3.exp(np.array([0, 0, 1.5, 0, 2.0, 0])), 0)
    other.component[:] = state.component
    np.testing.assert_array_equal(moved_scans(problem, other, state), [1, 4])
    np.testing.assert_array_equal(moved_scans(problem, state, state), [])


def test_joining_by_one_candidate_scores_its_posterior_odds() -> None:
    poses = room_poses(np.random.default_rng(0), 2)
    problem = build(2, linked(poses, {(0, 1): 0.8}), CONFIG)
    score = objective(problem, discrete.spanning_tree(problem, np.zeros(1)))
    least = CONFIG.min_probability / (1.0 - CONFIG.min_probability)
    assert score == pytest.approx(np.log((0.8 / 0.2 + CONFIG.chance_agreement) / least), abs=1e-9)


def test_the_acceptance_threshold_moves_the_odds() -> None:
    poses = room_poses(np.random.default_rng(0), 2)
    strict = GlobalConfig(min_probability=0.9)
    problem = build(2, linked(poses, {(0, 1): 0.8}), strict)
    [state] = discrete.search(problem, 4, 0)
    assert len(np.unique(state.component)) == 2


@pytest.mark.parametrize("value", [0.0, 1.0, float("nan")])
def test_probabilities_in_the_settings_are_open_intervals(value: float) -> None:
    with pytest.raises(ConfigError, match="min_probability"):
        GlobalConfig(min_probability=value)


def test_certain_pairs_are_bounded() -> None:
    poses = room_poses(np.random.default_rng(0), 2)
    problem = build(2, linked(poses, {(0, 1): 1.0}), CONFIG)
    assert problem.probability[0] == pytest.approx(0.99)
    assert np.isfinite(problem.evidence).all()


def test_agreement_does_not_depend_on_direction() -> None:
    poses, pairs = planted_graph(2, 6, 3)
    turned = [
        pair_result(
            p.target,
            p.source,
            [
                candidate(c.rank, se3.inverse(c.target_T_source), c.probability)
                for c in p.candidates
            ],
        )
        for p in pairs
    ]
    state = State(poses, np.zeros(6, dtype=np.int64))
    one, other = build(6, pairs, CONFIG), build(6, turned, CONFIG)
    np.testing.assert_allclose(agreement_now(one, state), agreement_now(other, state), atol=1e-9)
    assert agreement_now(one, state).max() > 0.5


def test_options_score_what_the_objective_gains() -> None:
    _, pairs = planted_graph(7, 6, 3, link_rate=0.9)
    problem = build(6, pairs, CONFIG)
    state = discrete.spanning_tree(problem, np.log(problem.evidence))
    block = np.arange(6) == 2
    choice = options(problem, state, block)
    apart = copy.deepcopy(state)
    apart.detach(block)
    assert choice.stay == pytest.approx(objective(problem, state) - objective(problem, apart))
    for k in range(len(choice.score)):
        moved = copy.deepcopy(state)
        moved.move(block, choice.motion[k], int(choice.component[k]))
        gained = objective(problem, moved) - objective(problem, apart)
        assert choice.score[k] == pytest.approx(gained, abs=1e-6)


def test_a_single_link_gives_its_own_probability() -> None:
    np.testing.assert_allclose(believed({(0, 1): 0.7}, 2, CONFIG), 0.7, atol=0.01)


def test_doubt_adds_up_along_a_chain() -> None:
    chain = {(0, 1): 0.9, (1, 2): 0.95, (2, 3): 0.8}
    probability = believed(chain, 4, CONFIG)
    core = 1
    assert probability[core] == pytest.approx(0.95, abs=0.01)
    assert probability[0] == pytest.approx(0.9, abs=0.01)
    assert probability[3] == pytest.approx(0.95 * 0.8, abs=0.01)


def test_a_leaf_behind_a_weak_link_carries_its_doubt() -> None:
    core = dict.fromkeys(itertools.combinations(range(4), 2), 0.95)
    tail = {(3, 4): 0.6, (4, 5): 0.98}
    probability = believed({**core, **tail}, 6, CONFIG)
    assert probability[:4].min() > 0.99
    assert probability[4] == pytest.approx(0.6, abs=0.02)
    assert probability[5] < 0.6


def test_loops_of_weak_links_are_believed() -> None:
    weak = dict.fromkeys(itertools.combinations(range(4), 2), 0.35)
    assert believed(weak, 4, CONFIG).min() > 0.9
    assert not believed({(0, 1): 0.35, (1, 2): 0.35, (2, 3): 0.35}, 4, CONFIG).any()


def test_doubtful_parts_keep_a_component_of_their_own() -> None:
    poses = room_poses(np.random.default_rng(1), 6)
    links = {(0, 1): 0.9, (1, 2): 0.9, (0, 2): 0.9, (3, 4): 0.9, (4, 5): 0.9, (3, 5): 0.9}
    problem = build(6, linked(poses, {**links, (2, 3): 0.6}), CONFIG)
    [state] = discrete.search(problem, 8, 0)
    assert len(np.unique(state.component)) == 1
    belief = drop_doubtful(problem, state, 0.8)
    assert len(np.unique(state.component)) == 2
    assert state.component[0] != state.component[3]
    assert belief.probability.min() > 0.8


def test_probabilities_hold_on_planted_graphs() -> None:
    config = GlobalConfig(chance_agreement=1e-3)
    claimed, right = [], []
    for seed in range(25):
        poses, pairs = planted_graph(seed, 7, 3, link_rate=0.5, strength=(0.2, 0.9))
        problem = build(7, pairs, config)
        [state] = discrete.search(problem, 4, seed)
        belief = drop_doubtful(problem, state, 0.5)
        for label in np.unique(state.component):
            members = np.flatnonzero(state.component == label)
            if len(members) > 1:
                claimed += belief.probability[members].tolist()
                right += largest_true_part(poses[members], state.pose[members]).tolist()
    assert len(claimed) > 50
    assert abs(np.mean(claimed) - np.mean(right)) < 0.1


def largest_true_part(truth: Array, found: Array) -> Array:
    """Which scans are right together; none when no two are."""
    gauges = truth @ se3.inverse(found)
    angle, shift = se3.distance(gauges[:, None] @ found[None], truth[None])
    right = (angle < np.radians(15.0)) & (shift < 0.3)
    best = right[int(np.argmax(right.sum(axis=1)))]
    return best if best.sum() > 1 else np.zeros(len(truth), dtype=bool)


def test_long_chains_of_moves_stay_rigid() -> None:
    poses, pairs = planted_graph(4, 12, 5, link_rate=0.3)
    problem = build(12, pairs, CONFIG)
    [state] = discrete.search(problem, 8, 0)
    turn = state.pose[:, :3, :3]
    np.testing.assert_allclose(
        turn @ np.swapaxes(turn, 1, 2), np.tile(np.eye(3), (12, 1, 1)), atol=1e-9
    )
    assert np.isfinite(gain_matrix(problem, state)).all()


@pytest.mark.parametrize(("overlap", "parts"), [(0.8, 2), (0.0, 1)])
def test_links_between_repeated_views_count_once(overlap: float, parts: int) -> None:
    poses = room_poses(np.random.default_rng(3), 6)
    groups = ({0, 1, 2}, {3, 4, 5})
    pairs = []
    for s, t in itertools.combinations(range(6), 2):
        together = any({s, t} <= group for group in groups)
        motion = se3.inverse(poses[t]) @ poses[s]
        probability, shared = (0.95, overlap) if together else (0.06, 0.0)
        pairs.append(pair_result(s, t, [candidate(0, motion, probability, shared)]))
    problem = build(6, pairs, CONFIG)
    [state] = discrete.search(problem, 8, 0)
    assert len(np.unique(state.component)) == 1
    drop_doubtful(problem, state, CONFIG.min_probability)
    assert len(np.unique(state.component)) == parts
