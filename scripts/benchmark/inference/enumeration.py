"""Every spanning forest of candidates: the truth about problems of a few scans."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from fewview.geometry import se3
from fewview.global_stage.model import Problem
from fewview.global_stage.placement import State, objective

MAX_CHOICES = 100_000
"""Combinations of candidates that are looked at; larger problems are refused."""


def best_forest(problem: Problem, seed: int) -> State:
    """The best of `forests`; the seed plays no part.

    Raises:
        ValueError: the problem is too large.
    """
    return max(forests(problem), key=lambda state: objective(problem, state))


def forests(problem: Problem) -> Iterator[State]:
    """Every labelling that at most one candidate a pair spans without a loop.

    Raises:
        ValueError: there are more than `MAX_CHOICES` combinations.
    """
    choices = [
        [-1, *np.flatnonzero(problem.pair == pair).tolist()] for pair in np.unique(problem.pair)
    ]
    if np.prod([len(choice) for choice in choices], dtype=np.float64) > MAX_CHOICES:
        raise ValueError("too many candidates to enumerate their forests")
    for combination in itertools.product(*choices):
        chosen = [c for c in combination if c >= 0]
        state = _chained(problem, chosen)
        if state is not None:
            yield state


def _chained(problem: Problem, chosen: list[int]) -> State | None:
    state = State.apart(problem.scans)
    for c in chosen:
        s, t = problem.source[c], problem.target[c]
        if state.component[s] == state.component[t]:
            return None
        motion = state.pose[t] @ problem.motion[c] @ se3.inverse(state.pose[s])
        state.move(state.component == state.component[s], motion, int(state.component[t]))
    return state
