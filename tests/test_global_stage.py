"""All pairs to one answer."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pytest

from benchmark.planted_graphs import (
    Noise,
    candidate,
    pair_result,
    planted_graph,
    room_poses,
    shaken,
    upright_levelling,
)
from fewview.config import GlobalConfig
from fewview.errors import ConfigError
from fewview.geometry import se3
from fewview.global_stage import solve
from fewview.types import Array, GlobalSolution, PairResult

CONFIG = GlobalConfig()


def run(
    poses: Array, pairs: Sequence[PairResult], config: GlobalConfig = CONFIG, seed: int = 0
) -> GlobalSolution:
    names = [f"frame-{i:04d}" for i in range(len(poses))]
    return solve(names, [upright_levelling(pose) for pose in poses], pairs, config, seed)


def outlier_graph(
    seed: int, scans: int, right_share: float, top_k: int = 4
) -> tuple[Array, list[PairResult]]:
    """Every candidate equally weak; the right one, where there is one, at a random rank."""
    rng = np.random.default_rng(seed)
    poses = room_poses(rng, scans)
    pairs = []
    for s, t in itertools.combinations(range(scans), 2):
        wrong = room_poses(rng, 2 * top_k)
        motions = list(se3.inverse(wrong[:top_k]) @ wrong[top_k:])
        if rng.uniform() < right_share:
            motions[rng.integers(top_k)] = se3.inverse(poses[t]) @ poses[s]
        made = [
            candidate(rank, shaken(rng, motion, Noise(2.0, 0.05)), right_share / top_k)
            for rank, motion in enumerate(motions)
        ]
        pairs.append(pair_result(s, t, made))
    return poses, pairs


def largest_errors(solution: GlobalSolution, poses: Array) -> tuple[float, float]:
    """Degrees and metres between all placed scans of the first component."""
    members = list(solution.components[0].scans)
    found = np.array([solution.placements[i].world_T_scan for i in members])
    ours = se3.inverse(found)[:, None] @ found
    true = se3.inverse(poses[members])[:, None] @ poses[members]
    angle, shift = se3.distance(ours, true)
    return float(np.degrees(angle.max())), float(shift.max())


@pytest.mark.parametrize("seed", range(4))
def test_weak_candidates_at_random_rank_are_told_apart(seed: int) -> None:
    """Wrong candidates come from a whole room here: chance agreement is rarer than on scans."""
    poses, pairs = outlier_graph(seed, 9, right_share=0.7)
    solution = run(poses, pairs, GlobalConfig(chance_agreement=0.01))
    assert solution.components[0].scans == tuple(range(9))
    angle, shift = largest_errors(solution, poses)
    assert angle < 5.0
    assert shift < 0.25
    assert np.mean([p.probability for p in solution.placements]) > 0.9


def test_at_most_one_candidate_a_pair_and_one_edge_each() -> None:
    poses, pairs = planted_graph(3, 8, 4, link_rate=0.8)
    solution = run(poses, pairs)
    assert list(solution.selected) == [(e.source, e.target) for e in solution.edges]
    assert solution.selected
    for edge in solution.edges:
        assert solution.selected[edge.source, edge.target] == edge.rank
        assert solution.placements[edge.source].component is not None
        assert solution.placements[edge.source].component == (
            solution.placements[edge.target].component
        )


def test_before_and_after_share_the_gauge() -> None:
    poses, pairs = outlier_graph(5, 6, right_share=0.9)
    solution = run(poses, pairs)
    first = solution.components[0].scans[0]
    np.testing.assert_allclose(
        solution.initial_world_T_scan[first], solution.placements[first].world_T_scan, atol=1e-3
    )


def test_the_world_is_upright_with_the_floor_at_zero() -> None:
    poses, pairs = outlier_graph(6, 7, right_share=0.9)
    solution = run(poses, pairs)
    heights = [p.world_T_scan[2, 3] for p in solution.placements if p.world_T_scan is not None]
    assert solution.components[0].world == "floor"
    np.testing.assert_allclose(heights, poses[:, 2, 3], atol=0.1)


def test_two_groups_are_two_components_largest_first() -> None:
    poses, pairs = outlier_graph(7, 8, right_share=1.0)
    small = {1, 4, 6}
    kept = [p for p in pairs if (p.source in small) == (p.target in small)]
    bridge = pair_result(1, 2, [candidate(0, np.eye(4), 0.2)])
    solution = run(poses, [*kept, bridge])
    assert [c.scans for c in solution.components] == [(0, 2, 3, 5, 7), (1, 4, 6)]
    assert solution.placements[4].component == 1
    for component in solution.components:
        assert component.nearest_link == "frame-0001 - frame-0002, probability 0.20"


def test_a_doubtful_scan_stays_unplaced_and_says_why() -> None:
    poses, pairs = outlier_graph(8, 5, right_share=1.0)
    lonely = [p for p in pairs if 3 not in (p.source, p.target)]
    weak = pair_result(1, 3, [candidate(0, se3.inverse(poses[3]) @ poses[1], 0.31)])
    placement = run(poses, [*lonely, weak]).placements[3]
    assert (placement.placed, placement.component, placement.probability) == (False, None, 0.0)
    assert placement.reason == (
        "no pose is probable enough: best link frame-0001 - frame-0003 has probability 0.31"
    )


def test_without_any_pair_nothing_is_placed() -> None:
    poses = room_poses(np.random.default_rng(0), 3)
    solution = run(poses, [pair_result(0, 1, [])])
    assert solution.components == ()
    assert solution.edges == ()
    assert all(p.world_T_scan is None for p in solution.placements)
    assert {p.reason for p in solution.placements} == {
        "no candidate pose links it to any other scan"
    }


def test_ten_runs_are_one() -> None:
    poses, pairs = planted_graph(11, 5, 3, link_rate=0.7)
    runs = [run(poses, pairs, GlobalConfig(restarts=4), seed=3) for _ in range(10)]
    for other in runs[1:]:
        assert other.selected == runs[0].selected
        assert other.edges == runs[0].edges
        for a, b in zip(runs[0].placements, other.placements, strict=True):
            assert (a.probability, a.reason) == (b.probability, b.reason)
            assert (a.world_T_scan is None) == (b.world_T_scan is None)
            if a.world_T_scan is not None and b.world_T_scan is not None:
                assert a.world_T_scan.tobytes() == b.world_T_scan.tobytes()


@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_the_scans_does_not_matter(seed: int) -> None:
    poses, pairs = outlier_graph(20 + seed, 7, right_share=0.8)
    order = np.random.default_rng(seed).permutation(7)
    place = np.argsort(order)
    shuffled = [
        pair_result(int(place[p.source]), int(place[p.target]), p.candidates) for p in pairs
    ]
    one = run(poses, pairs)
    other = run(poses[order], shuffled)
    ours = np.array([p.world_T_scan for p in one.placements])
    theirs = np.array([other.placements[i].world_T_scan for i in place])
    gauge = ours[0] @ se3.inverse(theirs[0])
    angle, shift = se3.distance(gauge @ theirs, ours)
    assert angle.max() < np.radians(0.5)
    assert shift.max() < 0.02


def torn_graph() -> tuple[Array, list[PairResult], Array]:
    """Five scans that hold together, but for scan 4, with two places; its second, by scan 0."""
    poses, pairs = outlier_graph(8, 5, right_share=1.0)
    kept = [p for p in pairs if 4 not in (p.source, p.target)]
    true = se3.inverse(poses[4]) @ poses[0]
    false = true @ se3.exp(np.array([0.0, 0.0, 1.5, 0.5, 2.0, 0.0]))
    torn = pair_result(0, 4, [candidate(0, true, 0.6), candidate(1, false, 0.3)])
    return poses, [*kept, torn], poses[0] @ se3.inverse(false)


def test_where_else_a_scan_could_stand() -> None:
    poses, pairs, elsewhere = torn_graph()
    solution = run(poses, pairs)
    assert solution.placements[4].placed
    alternative = solution.alternatives[0]
    assert [p.scan for p in alternative.places] == [4]
    assert alternative.odds == pytest.approx(0.5, rel=0.05)
    [place] = alternative.places
    assert place.component == 0
    gauge = solution.placements[0].world_T_scan @ se3.inverse(poses[0])
    angle, shift = se3.distance(place.world_T_scan, gauge @ elsewhere)
    assert angle < np.radians(3.0)
    assert shift < 0.1


def test_dropped_scans_are_shown_where_they_would_stand() -> None:
    """The best labelling itself is the first alternative where doubtful scans left it."""
    poses = room_poses(np.random.default_rng(1), 4)
    links = {(0, 1): 0.95, (1, 2): 0.65, (2, 3): 0.6}
    pairs = [
        pair_result(s, t, [candidate(0, se3.inverse(poses[t]) @ poses[s], p)])
        for (s, t), p in links.items()
    ]
    solution = run(poses, pairs)
    assert [p.placed for p in solution.placements] == [True, True, True, False]
    first = solution.alternatives[0]
    assert (first.margin, [p.scan for p in first.places]) == (0.0, [3])
    assert first.places[0].component == 0


def test_no_alternatives_are_made_when_none_are_asked_for() -> None:
    poses, pairs, _ = torn_graph()
    assert run(poses, pairs, GlobalConfig(alternatives=0)).alternatives == ()
    with pytest.raises(ConfigError, match="alternatives"):
        GlobalConfig(alternatives=-1)
