"""When two labellings are two answers, and which scans they disagree about."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fewview.geometry import se3
from fewview.global_stage.model import Problem
from fewview.global_stage.placement import State, likeness
from fewview.types import Array, BoolArray, IntArray


@dataclass(frozen=True)
class Answer:
    """A labelling and its log posterior, up to what is the same for all answers to a problem."""

    state: State
    score: float


def joined(state: State) -> BoolArray:
    """(n, n) pairs of scans in one frame."""
    return np.asarray(state.component[:, None] == state.component)


def joined_alike(problem: Problem, one: State, other: State) -> BoolArray:
    """(n, n) pairs that both labellings join at relative poses within the kernel's radius."""
    alike = likeness(problem, _relative(one), _relative(other)) > 0.0
    return joined(one) & joined(other) & alike


def says_new(problem: Problem, state: State, known: Iterable[State]) -> bool:
    """Whether a labelling joins, beside each known one, a pair that this one joins otherwise or
    not at all. Scans that are only taken apart say nothing new: that is doubt, not an answer."""
    said = joined(state)
    return all(bool(np.any(said & ~joined_alike(problem, state, other))) for other in known)


def distinct(problem: Problem, ranked: Iterable[State], count: int) -> list[State]:
    """The first ``count`` of the states that say something new after those before them."""
    found: list[State] = []
    for state in ranked:
        if len(found) < count and says_new(problem, state, found):
            found.append(state)
    return found


def moved_scans(problem: Problem, state: State, other: State) -> IntArray:
    """A small set of scans without which both labellings say the same.

    A greedy vertex cover of the pairs about which they disagree; of equals the one in the smaller
    component of ``other``.
    """
    apart = ~joined(state) & ~joined(other)
    disagree = ~(apart | joined_alike(problem, state, other))
    size = joined(other).sum(axis=1)
    moved: list[int] = []
    while disagree.any():
        scan = int(np.lexsort((size, -disagree.sum(axis=1)))[0])
        disagree[scan] = disagree[:, scan] = False
        moved.append(scan)
    return np.array(sorted(moved), dtype=np.int64)


def _relative(state: State) -> Array:
    """(n, n, 4, 4) target_T_source of every pair, target first."""
    return np.asarray(se3.inverse(state.pose)[:, None] @ state.pose)
