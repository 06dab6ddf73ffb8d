"""What candidates leave open, decided by planted potentials: places, answers, beliefs, links."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from planted_potentials import Planted, places_of
from scipy.special import logsumexp

from benchmark.planted_graphs import candidate, pair_result, upright_levelling
from fewview.config import GlobalConfig
from fewview.geometry import se3
from fewview.global_stage import solve
from fewview.global_stage.arrangement import Arranging
from fewview.global_stage.comparison import says_new
from fewview.global_stage.model import Problem, build
from fewview.global_stage.placement import State
from fewview.global_stage.places import created, places
from fewview.priors import PairPrior, Priors
from fewview.types import (
    Array,
    BoolArray,
    CandidateOrigin,
    GlobalSolution,
    PairResult,
    PairStatus,
)

CONFIG = GlobalConfig()
Pair = tuple[int, int]


def way(placed: Sequence[Array], source: int, target: int, at: Pair = (0, 0)) -> Array:
    """target_T_source with the source at its place at[0] and the target at its place at[1]."""
    return se3.inverse(placed[target][at[1]]) @ placed[source][at[0]]


def linked(
    placed: Sequence[Array], links: Mapping[Pair, float], at: Mapping[Pair, Pair] | None = None
) -> list[PairResult]:
    """All pairs; some have one exact candidate of a given probability, for the true places or for
    others."""
    out = []
    for pair in itertools.combinations(range(len(placed)), 2):
        motion = way(placed, *pair, (at or {}).get(pair, (0, 0)))
        found = [candidate(0, motion, links[pair])] if pair in links else []
        out.append(pair_result(*pair, found))
    return out


def problem_of(placed: Sequence[Array], pairs: Sequence[PairResult] = ()) -> Problem:
    return build(len(placed), pairs, CONFIG)


def standing(placed: Sequence[Array], component: Sequence[int]) -> State:
    """Every scan at its true place, in these frames."""
    return State(np.stack([one[0] for one in placed]), np.array(component, dtype=np.int64))


def only(*scans: int, of: int) -> BoolArray:
    return np.isin(np.arange(of), scans)


def unsettled(potentials: Planted, pairs: Sequence[PairResult] = ()) -> Arranging:
    """All is open."""
    count = len(potentials.places)
    problem = problem_of(potentials.places, pairs)
    return Arranging(problem, State.apart(count), np.zeros(count), potentials)


def run(
    potentials: Planted | None,
    placed: Sequence[Array],
    pairs: Sequence[PairResult],
    fixed: Mapping[int, Array] | None = None,
    seed: int = 0,
) -> GlobalSolution:
    names = [f"scan-{i}" for i in range(len(placed))]
    levellings = [upright_levelling(one[0]) for one in placed]
    return solve(names, levellings, pairs, CONFIG, seed, fixed, potentials)


def is_right(solution: GlobalSolution, placed: Sequence[Array], source: int, target: int) -> bool:
    """Whether two scans stand to each other as they truly do."""
    found = [solution.placements[i].world_T_scan for i in (source, target)]
    assert found[0] is not None and found[1] is not None
    turn, shift = se3.distance(se3.inverse(found[1]) @ found[0], way(placed, source, target))
    return bool(turn < np.radians(2.0) and shift < 0.05)


def core(scans: int, probability: float = 0.95) -> dict[Pair, float]:
    """Links that hold the first scans together beyond doubt."""
    return dict.fromkeys(itertools.combinations(range(scans), 2), probability)


# Places


def test_the_present_place_comes_first_and_no_two_are_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("fewview.global_stage.places.BEHIND", np.inf)
    placed = places_of(0, 4)
    problem = problem_of(placed, linked(placed, core(4), {(0, 3): (0, 1), (1, 3): (0, 1)}))
    state = standing(placed, [0, 0, 0, 0])
    block = only(3, of=4)
    found = places(problem, state, block, Planted(placed))
    motions = np.concatenate([np.eye(4)[None], found.motion]) @ state.pose[3]
    turn, shift = se3.distance(motions[:, None], motions)
    apart = (turn > np.radians(15.0)) | (shift > 0.3)
    assert np.all(apart | np.eye(len(motions), dtype=bool))
    assert found.stay == pytest.approx(-1.0 + 3 * 4.0 + 1 * np.log1p(problem.evidence[5]))
    other = se3.distance(found.motion @ state.pose[3], placed[3][1])
    assert np.sum((other[0] < 1e-6) & (other[1] < 1e-6)) == 1


def test_what_is_drawn_as_one_is_heard() -> None:
    placed = places_of(6, 4)
    problem = problem_of(placed, linked(placed, core(3)))
    state, block = standing(placed, [0, 0, 0, 3]), only(3, of=4)
    silent = places(problem, state, block, Planted(placed))
    heard = places(problem, state, block, Planted(placed, drawn=2.5))
    at_truth = [se3.distance(one.motion, np.eye(4))[1].argmin() for one in (silent, heard)]
    assert heard.score[at_truth[1]] == pytest.approx(silent.score[at_truth[0]] + 2.5)
    state.component[3] = 0
    there = places(problem, state, block, Planted(placed, drawn=2.5))
    assert there.stay == pytest.approx(heard.score[at_truth[1]])


def test_hopeless_places_are_given_up_and_no_others(monkeypatch: pytest.MonkeyPatch) -> None:
    placed = places_of(5, 7)
    problem = problem_of(placed, linked(placed, core(6)))
    state, block = standing(placed, [0, 0, 0, 0, 0, 0, 6]), only(6, of=7)
    found = places(problem, state, block, Planted(placed))
    monkeypatch.setattr("fewview.global_stage.places.BEHIND", np.inf)
    everything = places(problem, state, block, Planted(placed))
    worth = everything.score > everything.score.max() - 10.0
    assert 0 < worth.sum() < len(everything.score)
    assert len(found.score) < len(everything.score)
    np.testing.assert_allclose(found.score[: worth.sum()], everything.score[worth])


def test_scores_are_what_the_arrangement_gains(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fewview.global_stage.places.BEHIND", np.inf)
    placed = places_of(1, 5)
    arranging = unsettled(Planted(placed), linked(placed, {(0, 3): 0.4, (1, 2): 0.6, (2, 3): 0.3}))
    state = standing(placed, [0, 0, 2, 2, 4])
    state.pose[2:4] = se3.exp(np.array([0.1, 0.0, 0.4, 1.0, 2.0, 0.0])) @ state.pose[2:4]

    def score(one: State) -> float:
        joins = 5 - len(np.unique(one.component))
        return float(0.5 * arranging.matrix(one).sum()) - joins

    for block in (only(3, of=5), only(2, 3, of=5), only(4, of=5), only(0, 2, 3, of=5)):
        if len(np.unique(state.component[block])) > 1:
            continue
        found = places(arranging.problem, state, block, arranging.potentials)
        apart = state.copy()
        apart.detach(block)
        assert found.stay == pytest.approx(score(state) - score(apart))
        assert len(found.score) > 2
        for k in range(len(found.score)):
            moved = apart.copy()
            moved.move(block, found.motion[k], int(found.component[k]))
            assert found.score[k] == pytest.approx(score(moved) - score(apart), abs=1e-6)


def test_a_scan_alone_stays_for_nothing() -> None:
    placed = places_of(2, 3)
    state = standing(placed, [0, 0, 2])
    assert places(problem_of(placed), state, only(2, of=3), Planted(placed)).stay == 0.0


def test_blocks_move_rigidly_into_every_component() -> None:
    placed = places_of(3, 6)
    state = standing(placed, [0, 0, 2, 2, 4, 4])
    state.pose[2:4] = se3.exp(np.array([0.0, 0.0, 1.0, 3.0, 0.0, 0.0])) @ state.pose[2:4]
    found = places(problem_of(placed), state, only(2, 3, of=6), Planted(placed))
    assert set(found.component.tolist()) == {0, 4}
    for label, beside in ((0, 0), (4, 4)):
        best = np.flatnonzero(found.component == label)
        best = best[np.argmax(found.score[best])]
        assert found.score[best] == pytest.approx(-1.0 + 4 * 4.0)
        moved = se3.inverse(state.pose[beside]) @ found.motion[best] @ state.pose[2:4]
        expected = np.stack([way(placed, i, beside) for i in (2, 3)])
        np.testing.assert_allclose(moved, expected, atol=1e-9)


def test_created_pairs_run_from_the_smaller_index_and_carry_votes() -> None:
    placed = places_of(4, 4)
    problem = problem_of(placed, linked(placed, {(0, 2): 0.6, (2, 3): 0.5}))
    state = standing(placed, [0, 0, 2, 0])
    here = [np.eye(4), se3.inverse(placed[0][0])]
    pairs = list(created(problem, state, only(2, of=4), np.stack(here), np.array([0, 2])))
    assert {(p.source, p.target) for p in pairs} == {(0, 2), (1, 2), (2, 3)}
    votes = dict(zip([(0, 2), (2, 3)], np.log1p(problem.evidence), strict=True))
    for pair in pairs:
        np.testing.assert_array_equal(pair.here, [0])
        np.testing.assert_allclose(pair.poses[0], way(placed, pair.source, pair.target), atol=1e-9)
        assert pair.votes[0] == pytest.approx(votes.get((pair.source, pair.target), 0.0))


# The search


def labellings(potentials: Planted) -> dict[tuple[Pair, ...], float]:
    """Every arrangement at the planted places -> S'; an arrangement is the (component, place) of
    every scan, the place of scans alone 0."""
    count = len(potentials.places)
    choices = [list(itertools.product(range(count), range(len(p)))) for p in potentials.places]
    out: dict[tuple[Pair, ...], float] = {}
    for one in itertools.product(*choices):
        labels = [label for label, _ in one]
        ordered = all(label <= 1 + max([-1, *labels[:i]]) for i, label in enumerate(labels))
        if ordered and all(place == 0 or labels.count(label) > 1 for label, place in one):
            joins = count - len(set(labels))
            together = [p for p in itertools.combinations(range(count), 2) if said_of(one, p)]
            said = [potentials.said[i, j][one[i][1], one[j][1]] for i, j in together]
            out[one] = joins * potentials.join + float(np.sum(said))
    return out


def said_of(one: Sequence[Pair], pair: Pair) -> bool:
    return one[pair[0]][0] == one[pair[1]][0]


def drawn(seed: int) -> Planted:
    """Three scans, of which the first has one place and the others two; the true one is mostly the
    best."""
    rng = np.random.default_rng(seed)
    placed = places_of(seed, 3)
    placed[0] = placed[0][:1]
    said = {}
    for i, j in itertools.combinations(range(3), 2):
        said[i, j] = rng.normal(-1.0, 1.5, (len(placed[i]), len(placed[j])))
        said[i, j][0, 0] += 3.5
    return Planted(placed, said, elsewhere=-9.0)


@pytest.mark.parametrize("seed", range(12))
def test_the_search_reaches_the_best_of_all_arrangements(seed: int) -> None:
    potentials = drawn(seed)
    arranging = unsettled(potentials)
    found = arranging.search(0, 4)
    assert found[0].score == pytest.approx(max(labellings(potentials).values()))
    for k, one in enumerate(found):
        assert k == 0 or one.score <= found[k - 1].score
        assert says_new(arranging.problem, one.state, [other.state for other in found[:k]])
        joins = 3 - len(np.unique(one.state.component))
        gained = 0.5 * arranging.matrix(one.state).sum() + joins * potentials.join
        assert one.score == pytest.approx(gained)


def test_beliefs_are_those_of_all_arrangements() -> None:
    """Exact up to arrangements that differ in several scans; these make it too sure where little
    is."""
    excess, sure = [], []
    for seed in range(12):
        potentials = drawn(seed)
        arranging = unsettled(potentials)
        state = arranging.search(0, 1)[0].state
        if len(np.unique(state.component)) == 1:
            expected = beliefs(potentials)
            excess += (arranging.judge(state) - expected).tolist()
            sure += (expected > 0.9).tolist()
    assert len(excess) >= 24 and sum(sure) >= 12
    assert np.abs(excess)[sure].max() < 0.03
    assert np.mean(np.abs(excess)) < 0.04
    assert min(excess) > -0.02 and max(excess) < 0.2


def beliefs(potentials: Planted) -> Array:
    """(3,) that a scan stands right relative to the one to which most do, where the best
    arrangement has all in one component."""
    scores = labellings(potentials)
    best = max(scores, key=lambda one: scores[one])
    mass = np.exp(np.array(list(scores.values())) - logsumexp(list(scores.values())))
    right = np.eye(3)
    for i, j in itertools.permutations(range(3), 2):
        agree = [
            said_of(one, (i, j)) and (one[i][1], one[j][1]) == (best[i][1], best[j][1])
            for one in scores
        ]
        right[i, j] = mass[agree].sum()
    core = int(np.argmax(right.sum(axis=1)))
    right[core, core] = np.max(np.delete(right[core], core))
    return np.asarray(right[core])


def test_weak_candidates_that_the_scans_confirm_are_found_and_believed() -> None:
    placed = places_of(5, 4)
    links = {(0, 1): 0.3, (1, 2): 0.3, (2, 3): 0.3}
    pairs = linked(placed, links)
    assert run(None, placed, pairs).components == ()
    solution = run(Planted(placed, join=-4.0), placed, pairs)
    assert [c.scans for c in solution.components] == [(0, 1, 2, 3)]
    assert all(is_right(solution, placed, i, j) for i, j in itertools.combinations(range(4), 2))
    assert min(p.probability for p in solution.placements) > 0.95


def test_components_move_as_a_whole() -> None:
    """No scan leaves the one that it has for the two that it gains."""
    placed = places_of(25, 4)
    across = np.array([[0.8, -3.0], [-3.0, -3.0]])
    said = {(i, j): across for i in (0, 1) for j in (2, 3)}
    pairs = linked(placed, {(0, 1): 0.6, (2, 3): 0.6})
    solution = run(Planted(placed, said), placed, pairs)
    assert [c.scans for c in solution.components] == [(0, 1, 2, 3)]


def test_many_who_say_little_do_not_join_two_rooms() -> None:
    placed = places_of(8, 8, count=1)
    little = {(i, j): np.full((1, 1), 0.5) for i in range(4) for j in range(4, 8)}
    solution = run(Planted(placed, little, join=-3.5), placed, linked(placed, {}))
    assert [c.scans for c in solution.components] == [(0, 1, 2, 3), (4, 5, 6, 7)]


def test_scans_without_any_candidate_are_joined() -> None:
    placed = places_of(6, 3)
    solution = run(Planted(placed), placed, linked(placed, {}))
    assert [c.scans for c in solution.components] == [(0, 1, 2)]
    assert is_right(solution, placed, 0, 2) and is_right(solution, placed, 1, 2)


def test_a_scan_that_the_others_contradict_is_not_placed() -> None:
    placed = places_of(7, 4)
    pairs = linked(placed, {**core(3), (2, 3): 0.7}, {(2, 3): (0, 1)})
    assert run(None, placed, pairs).placements[3].placed
    silent = {(i, 3): np.full((2, 2), -3.0) for i in range(3)}
    solution = run(Planted(placed, silent), placed, pairs)
    assert [p.placed for p in solution.placements] == [True, True, True, False]
    assert solution.selected.keys() == {(0, 1), (0, 2), (1, 2)}


def test_a_wrong_candidate_gives_way_to_what_the_others_see() -> None:
    placed = places_of(8, 4)
    pairs = linked(placed, {**core(3), (2, 3): 0.7}, {(2, 3): (0, 1)})
    solution = run(Planted(placed), placed, pairs)
    assert all(is_right(solution, placed, i, 3) for i in range(3))
    assert (2, 3) not in solution.selected or solution.selected[2, 3] != 0


def test_sure_scans_stay_as_they_stand_and_are_asked_about_their_links_alone() -> None:
    placed = places_of(9, 4)
    against = {pair: np.full((2, 2), -3.0) for pair in core(3)}
    potentials = Planted(placed, {**against, (0, 3): np.array([[5.0, -3.0], [-3.0, -3.0]])})
    solution = run(potentials, placed, linked(placed, core(3)))
    assert solution.components[0].scans == (0, 1, 2, 3)
    assert is_right(solution, placed, 0, 1) and is_right(solution, placed, 1, 2)
    asked = Counter(potentials.asked)
    assert set(asked) == {*core(3), (0, 3), (1, 3), (2, 3)}
    assert max(asked[pair] for pair in core(3)) <= 2


def test_a_sure_scan_that_the_others_deny_is_set_apart() -> None:
    placed = places_of(26, 3)
    denied = {(0, 2): np.full((2, 2), -20.0), (1, 2): np.full((2, 2), -20.0)}
    pairs = linked(placed, core(3))
    assert len(run(None, placed, pairs).components[0].scans) == 3
    solution = run(Planted(placed, denied), placed, pairs)
    assert [c.scans for c in solution.components] == [(0, 1)]


def test_sure_clusters_are_joined_by_what_their_scans_say() -> None:
    placed = places_of(24, 6)
    links = {**core(3), **{(i + 3, j + 3): p for (i, j), p in core(3).items()}}
    pairs = linked(placed, links)
    assert len(run(None, placed, pairs).components) == 2
    solution = run(Planted(placed), placed, pairs)
    assert [c.scans for c in solution.components] == [tuple(range(6))]
    assert is_right(solution, placed, 0, 3) and is_right(solution, placed, 2, 5)
    assert len(solution.found) == 1


def test_sure_scans_that_come_apart_are_a_component() -> None:
    """Two clusters stand together at one of two places, neither of which is believed."""
    placed = places_of(10, 6)
    turned = se3.exp(np.array([0.0, 0.0, 2.0, 1.0, 1.0, 0.0]))
    for i in range(3, 6):
        placed[i][1] = turned @ placed[i][0]
    torn = np.array([[0.45, 0.4], [-3.0, -3.0]])
    said = {(i, j): torn for i in range(3) for j in range(3, 6)}
    links = {**core(3), **{(i + 3, j + 3): p for (i, j), p in core(3).items()}}
    solution = run(Planted(placed, said, join=-5.0), placed, linked(placed, links))
    assert [c.scans for c in solution.components] == [(0, 1, 2), (3, 4, 5)]
    assert min(p.probability for p in solution.placements) > 0.95


def test_told_pairs_never_part() -> None:
    """They hang on the others by what is not believed, and all but the user is against them."""
    placed = places_of(11, 5)
    turned = se3.exp(np.array([0.0, 0.0, 2.0, 1.0, 1.0, 0.0]))
    for i in (3, 4):
        placed[i][1] = turned @ placed[i][0]
    torn = np.array([[0.45, 0.4], [-3.0, -3.0]])
    said = {(i, j): torn for i in range(3) for j in (3, 4)}
    potentials = Planted(placed, {**said, (3, 4): np.full((2, 2), -9.0)}, join=-3.0)
    priors = Priors(pairs={(3, 4): PairPrior(way(placed, 3, 4))})
    pairs = [priors.constrain(pair) for pair in linked(placed, core(3))]
    solution = run(potentials, placed, pairs)
    priors.check(pairs, solution)
    assert [c.scans for c in solution.components] == [(0, 1, 2), (3, 4)]
    assert is_right(solution, placed, 3, 4)
    assert min(p.probability for p in solution.placements) > 0.95


def test_told_scans_carry_the_doubt_of_their_block_once() -> None:
    placed = places_of(12, 5)
    priors = Priors(pairs={(3, 4): PairPrior(way(placed, 3, 4))})
    pairs = [priors.constrain(p) for p in linked(placed, {**core(3), (2, 3): 0.6})]
    said = {(i, j): np.zeros((2, 2)) for i in range(3) for j in (3, 4)}
    said[3, 4] = np.full((2, 2), -20.0)
    solution = run(Planted(placed, said, join=-3.1), placed, pairs)
    chance = 1.0 / (1.0 + np.exp(3.1 - np.log1p(0.6 / 0.4 / CONFIG.chance_agreement)))
    for scan in (3, 4):
        assert solution.placements[scan].probability == pytest.approx(chance, abs=0.02)


def test_fixed_scans_never_part() -> None:
    placed = places_of(13, 4)
    fixed = {0: placed[0][0], 3: placed[3][0]}
    priors = Priors(poses=fixed)
    pairs = [priors.constrain(p) for p in linked(placed, {(0, 1): 0.5})]
    solution = run(Planted(placed, {(0, 3): np.full((2, 2), -9.0)}), placed, pairs, fixed)
    assert [(c.scans, c.world) for c in solution.components] == [((0, 1, 2, 3), "given")]
    for scan, pose in fixed.items():
        np.testing.assert_allclose(solution.placements[scan].world_T_scan, pose, atol=1e-9)
    assert is_right(solution, placed, 1, 0) and is_right(solution, placed, 2, 3)


def test_the_same_seed_gives_the_same_answer() -> None:
    placed = places_of(14, 5)
    pairs = linked(placed, {(0, 1): 0.4, (1, 2): 0.5, (3, 4): 0.4}, {(1, 2): (0, 1)})
    one, other = (run(Planted(placed), placed, pairs, seed=3) for _ in range(2))
    assert one.selected == other.selected and one.edges == other.edges
    assert [p.probability for p in one.placements] == [p.probability for p in other.placements]
    for a, b in zip(one.placements, other.placements, strict=True):
        np.testing.assert_array_equal(a.world_T_scan, b.world_T_scan)


def test_what_else_the_scans_could_be_is_told() -> None:
    placed = places_of(15, 4)
    said = {(i, 3): np.array([[2.0, 1.7], [-3.0, -3.0]]) for i in range(3)}
    solution = run(Planted(placed, said), placed, linked(placed, core(3)))
    assert is_right(solution, placed, 3, 0)
    [first, *_] = solution.alternatives
    assert [p.scan for p in first.places] == [3]
    assert first.odds == pytest.approx(np.exp(-0.9), rel=0.01)


# Links


def test_bridges_join_what_candidates_leave_apart() -> None:
    placed = places_of(16, 5)
    pairs = linked(placed, {**core(3), (3, 4): 0.9, (0, 3): 0.3}, {(0, 3): (1, 1)})
    strongest = {(1, 3): np.array([[6.0, -3.0], [-3.0, -3.0]])}
    solution = run(Planted(placed, strongest), placed, pairs)
    assert [c.scans for c in solution.components] == [(0, 1, 2, 3, 4)]
    assert list(solution.found) == [(1, 3)]
    found = solution.found[1, 3]
    assert (found.rank, found.origin) == (0, CandidateOrigin.TOGETHER)
    np.testing.assert_allclose(found.target_T_source, way(placed, 1, 3), atol=1e-6)
    assert found.probability == pytest.approx(
        min(solution.placements[i].probability for i in (1, 3))
    )
    assert {(e.source, e.target): e.rank for e in solution.edges} == solution.selected
    assert solution.selected.keys() == {*core(3), (3, 4), (1, 3)}


def test_a_bridge_ranks_after_the_candidates_of_its_pair() -> None:
    placed = places_of(17, 3)
    pairs = linked(placed, {**core(2), (0, 2): 0.3, (1, 2): 0.3}, {(0, 2): (1, 1), (1, 2): (1, 1)})
    solution = run(Planted(placed), placed, pairs)
    [(ends, found)] = solution.found.items()
    assert found.rank == 1 == solution.selected[ends]
    reported = {(p.source, p.target): p for p in solution.with_found(pairs)}
    assert [c.rank for c in reported[ends].candidates] == [0, 1]
    assert reported[ends].candidates[1] is found
    assert reported[0, 1] is pairs[0]


def test_probabilities_of_a_pair_with_a_found_candidate_exclude_each_other() -> None:
    placed = places_of(18, 2)
    pair = pair_result(0, 1, [candidate(0, way(placed, 0, 1, (1, 0)), 0.6)])
    found = {(0, 1): candidate(1, way(placed, 0, 1), 0.9)}
    solution = GlobalSolution((), (), {(0, 1): 1}, {}, (), found=found)
    [reported] = solution.with_found([pair])
    np.testing.assert_allclose([c.probability for c in reported.candidates], [0.06, 0.9])


def test_nothing_is_found_where_candidates_hold_everything_together() -> None:
    placed = places_of(19, 4)
    pairs = linked(placed, {(0, 1): 0.6, (1, 2): 0.6, (2, 3): 0.6})
    solution = run(Planted(placed), placed, pairs)
    assert solution.components[0].scans == (0, 1, 2, 3)
    assert solution.found == {} and solution.with_found(pairs) == tuple(pairs)


# Vetoes


def vetoed(pairs: Sequence[PairResult], *which: Pair) -> list[PairResult]:
    priors = Priors(pairs={pair: PairPrior(veto="all") for pair in which})
    return [priors.constrain(pair) for pair in pairs]


def test_only_what_the_user_ruled_out_is_a_veto() -> None:
    placed = places_of(20, 3)
    pairs = linked(placed, {(0, 1): 0.0, (1, 2): 0.5, (0, 2): 0.5})
    assert problem_of(placed, pairs).vetoed == {}
    problem = problem_of(placed, vetoed(pairs, (0, 2)))
    assert list(problem.vetoed) == [(0, 2)]
    np.testing.assert_array_equal(problem.vetoed[0, 2], way(placed, 0, 2)[None])
    turned = replace(vetoed(pairs, (0, 2))[1], source=2, target=0)
    backward = problem_of(placed, [turned]).vetoed
    np.testing.assert_allclose(backward[0, 2][0] @ way(placed, 0, 2), np.eye(4), atol=1e-9)


def test_no_place_brings_a_pair_back_to_where_it_was_vetoed() -> None:
    placed = places_of(21, 3)
    pairs = linked(placed, {(0, 1): 0.9, (0, 2): 0.8})
    state = standing(placed, [0, 0, 2])
    block = only(2, of=3)
    free = places(problem_of(placed, pairs), state, block, Planted(placed))
    bound = places(problem_of(placed, vetoed(pairs, (0, 2))), state, block, Planted(placed))
    at_truth = [se3.distance(p.motion, np.eye(4))[1].min(initial=9.0) for p in (free, bound)]
    assert at_truth[0] < 1e-6 and at_truth[1] > 0.3
    state.component[2] = 0
    problem = problem_of(placed, vetoed(pairs, (0, 2)))
    assert places(problem, state, block, Planted(placed)).stay == -np.inf


def test_the_arrangement_does_not_put_a_vetoed_pair_back() -> None:
    """All scans say that the vetoed pose is right, and less loudly that another is."""
    placed = places_of(22, 4)
    said = {(i, 3): np.array([[4.0, 2.0], [-3.0, -3.0]]) for i in range(3)}
    pairs = linked(placed, {**core(3), (0, 3): 0.9})
    assert is_right(run(Planted(placed, said), placed, pairs), placed, 0, 3)
    solution = run(Planted(placed, said), placed, vetoed(pairs, (0, 3)))
    assert solution.placements[3].placed
    shown = se3.inverse(solution.initial_world_T_scan[0]) @ solution.initial_world_T_scan[3]
    np.testing.assert_allclose(shown, way(placed, 3, 0, (1, 0)), atol=1e-6)
    for other in solution.alternatives:
        assert all(p.scan != 3 or p.world_T_scan is None for p in other.places)


def test_a_place_that_candidates_of_others_make_is_left_when_vetoed() -> None:
    """A chain of weak candidates leads to the vetoed pose; the start from it is mended."""
    placed = places_of(23, 3)
    pairs = vetoed(linked(placed, {(0, 1): 0.6, (1, 2): 0.6, (0, 2): 0.2}), (0, 2))
    solution = run(Planted(placed), placed, pairs)
    together = [p.component == 0 for p in solution.placements]
    assert not (together[0] and together[2] and is_right(solution, placed, 0, 2))
    assert pairs[1].status is PairStatus.NOTHING_BELIEVABLE
