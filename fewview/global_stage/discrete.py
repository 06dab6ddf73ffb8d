"""Search for the best labelling: seeded spanning trees, then local moves of scans and blocks.

Each start grows a maximum spanning tree over the candidates, its keys perturbed by Gumbel noise
in all starts but the first, so that trees are drawn by their candidates' odds. Then scans, and the
blocks of scans on either side of a weak link, are moved to the best place that any candidate
proposes, or set apart, until nothing improves the objective of `model`. Joining costs nothing at
first: links that are too weak alone stay until it is known which loops they close.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fewview.geometry import se3
from fewview.global_stage.blocks import pieces, tree_blocks
from fewview.global_stage.comparison import says_new
from fewview.global_stage.model import Problem
from fewview.global_stage.placement import State, gain_matrix, objective, options
from fewview.types import Array, BoolArray

POLISHED = 8
"""Starts, best after one pass over the scans, that are searched to the end."""

TRIALS = 64
"""Moves of blocks looked at for each answer that is asked for."""

PROSPECT = 8.0
"""A move that loses more of the objective leads to no answer that is worth telling."""

TOLERANCE = 1e-9
"""Smallest improvement of the objective that counts."""


def search(problem: Problem, restarts: int, seed: int, count: int = 1) -> list[State]:
    """The best labellings found, best first, each an answer of its own (`comparison.says_new`).

    Runners-up are local optima in which other starts ended, and states one move of a block away
    from the best, after the scans outside the block have settled.

    Args:
        problem: the candidates.
        restarts: number of spanning trees to start from.
        seed: of the perturbed trees and of the order of moves.
        count: labellings at most; there is always one.
    """
    rng = np.random.default_rng(seed)
    free = replace(problem, join_cost=0.0)
    found: list[State] = []
    for start in range(max(restarts, 1)):
        noise = rng.gumbel(size=len(problem.source)) if start else np.zeros(len(problem.source))
        state = spanning_tree(problem, np.log(problem.evidence) + noise)
        for scan in rng.permutation(problem.scans):
            _improve(free, state, np.arange(problem.scans) == scan)
        found.append(state)
    started = _ranked(free, found)[:POLISHED]
    polished = [_polish(problem, _polish(free, state)) for state in started]
    return _distinct_best(problem, _ranked(problem, polished), count)


def _distinct_best(problem: Problem, ranked: list[State], count: int) -> list[State]:
    """The best ``count`` answers among ``ranked`` states, the neighbours of the best of them, the
    neighbours of the second best, and so on."""
    answers = ranked[:1]
    while len(answers) < count:
        ranked = _ranked(problem, ranked + _neighbours(problem, answers[-1], ranked, count))
        following = [state for state in ranked if says_new(problem, state, answers)]
        if not following:
            break
        answers.append(following[0])
    return _ranked(problem, answers)


def _ranked(problem: Problem, states: Sequence[State]) -> list[State]:
    return sorted(states, key=lambda state: -objective(problem, state))


def spanning_tree(problem: Problem, key: Array) -> State:
    """Chain candidates into poses, highest ``key`` first, as Kruskal's algorithm does."""
    state = State.apart(problem.scans)
    grown(problem, state, key)
    return state


def grown(problem: Problem, state: State, key: Array) -> None:
    """Join the components of a labelling, in place, by candidates of the highest ``key`` first."""
    for c in np.argsort(-key, kind="stable"):
        s, t = problem.source[c], problem.target[c]
        joined, other = state.component[t], state.component[s]
        if joined != other:
            block = state.component == other
            motion = state.pose[t] @ problem.motion[c] @ se3.inverse(state.pose[s])
            state.move(block, motion, int(joined))


def _neighbours(problem: Problem, state: State, known: Sequence[State], count: int) -> list[State]:
    """Answers beside ``known`` ones that differ from a state in the place of one block and in what
    follows from it."""
    singles = np.eye(problem.scans, dtype=bool)
    moves = [
        (choice.score[k] - choice.stay, block, choice.motion[k], int(choice.component[k]))
        for block in np.unique(np.concatenate([singles, _blocks(problem, state)]), axis=0)
        for choice in [options(problem, state, block)]
        for k in np.flatnonzero(~choice.same & (choice.score > choice.stay - PROSPECT))
    ]
    moves.sort(key=lambda move: -move[0])
    found: list[State] = []
    for _, block, motion, component in moves[: TRIALS * count]:
        moved = state.copy()
        moved.move(block, motion, component)
        if len(found) < count and says_new(problem, moved, [*known, *found]):
            found.append(_settled(problem, moved, block, [*known, *found]))
    return found


def _settled(problem: Problem, moved: State, block: BoolArray, known: Sequence[State]) -> State:
    """The local optimum next to ``moved``, or where that is known, the best place of the other
    scans while the block stays, or where that is known too, the state itself."""
    around = moved.copy()
    _separate(problem, around)
    _settle_scans(problem, around, held=block)
    _separate(problem, around)
    for settled in (_polish(problem, around.copy()), around):
        if says_new(problem, settled, known):
            return settled
    return moved


def _polish(problem: Problem, state: State) -> State:
    """Move blocks and scans in turn until neither improves."""
    improved = True
    while improved:
        _separate(problem, state)
        moved = [_improve(problem, state, block) for block in _blocks(problem, state)]
        improved = _settle_scans(problem, state) or any(moved)
    return state


def _settle_scans(problem: Problem, state: State, held: BoolArray | None = None) -> bool:
    """Re-place single scans, but not those ``held``, until none improves; only neighbours of a
    moved scan look again."""
    linked = np.zeros((problem.scans, problem.scans), dtype=bool)
    linked[problem.source, problem.target] = linked[problem.target, problem.source] = True
    if held is not None:
        linked[:, held] = False
    free = range(problem.scans) if held is None else np.flatnonzero(~held).tolist()
    waiting, moved = deque(free), False
    while waiting:
        scan = waiting.popleft()
        if _improve(problem, state, np.arange(problem.scans) == scan):
            moved = True
            waiting += [j for j in np.flatnonzero(linked[scan]).tolist() if j not in waiting]
    return moved


def _blocks(problem: Problem, state: State) -> BoolArray:
    """Sides of weak links and whole components, larger than one scan."""
    whole = state.component == np.unique(state.component)[:, None]
    rows = np.concatenate([tree_blocks(gain_matrix(problem, state)), whole])
    return np.asarray(rows[rows.sum(axis=1) > 1])


def _separate(problem: Problem, state: State) -> None:
    """Give parts that no agreeing candidate links frames of their own: that saves join costs."""
    _, label = pieces(gain_matrix(problem, state))
    state.component[:] = label


def _improve(problem: Problem, state: State, block: BoolArray) -> bool:
    """Move a block to its best place, or apart, if that improves; blocks torn since are left."""
    if len(np.unique(state.component[block])) != 1:
        return False
    choice = options(problem, state, block)
    best = int(np.argmax(choice.score)) if len(choice.score) else -1
    gain = choice.score[best] if best >= 0 else -np.inf
    if max(gain, 0.0) <= choice.stay + TOLERANCE:
        return False
    if gain > 0.0:
        state.move(block, choice.motion[best], int(choice.component[best]))
    else:
        state.detach(block)
    return True
