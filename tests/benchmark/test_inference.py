"""Inference methods on problems that can be enumerated, and what they have in common."""

from __future__ import annotations

import pickle
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from benchmark.inference import cost_network, labels
from benchmark.inference.compare import rows_of, summary_of, table_of
from benchmark.inference.enumeration import best_forest, forests
from benchmark.inference.finish import separate
from benchmark.inference.methods import Method, methods, tree
from benchmark.inference.problems import POOLED, Posed, filed
from benchmark.planted_graphs import candidate, pair_result, planted_graph, room_poses
from fewview.config import GlobalConfig
from fewview.geometry import se3
from fewview.global_stage.model import Problem, build
from fewview.global_stage.placement import State, gain_matrix, objective

CONFIG = GlobalConfig()
LEFT_BEHIND = {
    "tree": 3.0,
    "edge_bp": 3.0,
    "camera_bp": 0.2,
    "place_bp": 0.2,
    "ours": 1e-6,
    "toulbar2": 0.2,
    "toulbar2_ours": 1e-3,
}
"""How far below the best of all forests a method may be in the mean."""


def tiny(seed: int) -> Problem:
    _, pairs = planted_graph(seed, 4, 2, link_rate=0.9)
    return build(4, pairs, CONFIG)


@cache
def best_of(seed: int) -> float:
    """The highest objective of all forests of a tiny problem."""
    return objective(tiny(seed), best_forest(tiny(seed), 0))


def network_of(seed: int) -> labels.Network:
    _, pairs = planted_graph(seed, 5, 3, link_rate=0.9)
    return labels.build(build(5, pairs, CONFIG), 0)


@pytest.mark.parametrize("name", sorted(methods()))
def test_methods_on_problems_that_can_be_enumerated(name: str) -> None:
    solve = methods()[name].solve
    gaps = [best_of(seed) - objective(tiny(seed), solve(tiny(seed), seed)) for seed in range(6)]
    assert np.mean(gaps) < LEFT_BEHIND[name]


@pytest.mark.parametrize("name", sorted(methods()))
def test_exact_links_are_all_taken(name: str) -> None:
    poses = room_poses(np.random.default_rng(0), 5)
    pairs = [
        pair_result(s, t, [candidate(0, se3.inverse(poses[t]) @ poses[s], 0.8)])
        for s in range(5)
        for t in range(s + 1, 5)
        if (s < 3) == (t < 3)
    ]
    problem = build(5, pairs, CONFIG)
    state = methods()[name].solve(problem, 0)
    assert len(set(state.component[:3])) == len(set(state.component[3:])) == 1
    assert state.component[0] != state.component[3]
    found = se3.inverse(state.pose[0]) @ state.pose[2]
    np.testing.assert_allclose(found, se3.inverse(poses[0]) @ poses[2], atol=1e-6)


@pytest.mark.parametrize("name", sorted(methods()))
def test_nothing_to_join(name: str) -> None:
    state = methods()[name].solve(build(3, [pair_result(0, 1, [])], CONFIG), 0)
    assert len(np.unique(state.component)) == 3


def test_too_many_forests_are_refused() -> None:
    _, pairs = planted_graph(0, 12, 5, link_rate=0.9)
    with pytest.raises(ValueError, match="too many"):
        next(forests(build(12, pairs, CONFIG)))


def test_a_network_scores_what_the_objective_does() -> None:
    network = network_of(0)
    rng = np.random.default_rng(0)
    for _ in range(20):
        label = np.array([rng.choice(np.flatnonzero(own)) for own in network.allowed])
        state = State(
            network.place[np.arange(5), label], np.where(label > 0, 5, np.arange(5)).astype(int)
        )
        assert network.score(label) == pytest.approx(objective(network.problem, state), abs=1e-9)


def test_the_optimum_of_a_network_is_above_its_messages() -> None:
    if not cost_network.available():
        pytest.skip("toulbar2 is not installed")
    for seed in range(4):
        _, pairs = planted_graph(seed, 7, 3, link_rate=0.5)
        problem = build(7, pairs, CONFIG)
        exact, messages = (
            objective(problem, methods()[name].solve(problem, 0))
            for name in ("toulbar2", "place_bp")
        )
        assert exact > messages - 1e-3


def test_separating_never_lowers_the_objective() -> None:
    for seed in range(6):
        problem = tiny(seed)
        state = tree(problem, 0)
        again = separate(problem, state.copy())
        assert objective(problem, again) == objective(problem, state)
        shaken = state.copy()
        shaken.component[:] = 0
        before = objective(problem, shaken)
        assert objective(problem, separate(problem, shaken)) >= before
        linked = gain_matrix(problem, shaken) > 0.0
        assert not np.any(linked & (shaken.component[:, None] != shaken.component))


def test_files_with_problems(tmp_path: Path) -> None:
    poses, pairs = planted_graph(0, 5, 2)
    results = {(p.source, p.target): p for p in pairs}
    room = {"poses": poses, "sets": [("random", [0, 2, 4]), ("low", [1, 2])], "pairs": results}
    (tmp_path / "room.pkl").write_bytes(pickle.dumps(room))
    found = list(filed(tmp_path, CONFIG))
    assert [len(one.truth) for one in found] == [3, 2, 4]
    assert POOLED in found[-1].group
    np.testing.assert_array_equal(found[0].truth, poses[[0, 2, 4]])
    kept = [p for p in pairs if {p.source, p.target} <= {0, 2, 4}]
    assert len(found[0].problem.source) == len(build(5, kept, CONFIG).source)
    with pytest.raises(SystemExit, match="holds no problems"):
        list(filed(tmp_path / "nowhere", CONFIG))


def test_rows_and_means() -> None:
    truth = room_poses(np.random.default_rng(0), 3)
    pairs = [
        pair_result(s, t, [candidate(0, se3.inverse(truth[t]) @ truth[s], 0.8)])
        for s, t in ((0, 1), (1, 2))
    ]
    problems = [Posed("g", build(3, pairs, CONFIG), truth)]
    known = {
        "tree": Method("Tree", tree),
        "none": Method("Nothing", lambda problem, seed: State.apart(problem.scans)),
    }
    rows = rows_of(known, problems, 0)
    assert [row["right"] for row in rows] == [3, 0]
    assert rows[0]["gap"] == 0.0
    assert rows[1]["gap"] == pytest.approx(rows[0]["objective"])
    first, second = summary_of(rows)
    assert (first["at_best"], second["at_best"]) == (1.0, 0.0)
    assert first["right"] == 1.0
    assert "Nothing" in table_of([first, second], known, "title").markdown()
