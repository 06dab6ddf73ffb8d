"""Links between the same two places share their mistakes; only what is new in each counts.

If scans i and i' show the same surfaces, and j and j' do, then whatever fools the pair (i, j) also
fools (i', j'): a repeated desk makes all links between two groups of views agree on a wrong pose.
The overlap of i with i' times that of j with j' is taken as the chance that the second link only
repeats the first. Links are counted from the strongest down, each by the chance that it repeats
none before it.
"""

from __future__ import annotations

import numpy as np

from fewview.global_stage.model import Problem
from fewview.global_stage.placement import Options, State, agreement_now
from fewview.types import Array

MAX_LINKS = 48
"""Strongest links of a block that are counted."""


def shared_views(problem: Problem, state: State) -> Array:
    """(n, n) overlap 0..1 of scans that stand together, as the agreeing candidates show it."""
    shared = np.eye(problem.scans)
    overlap = np.clip(problem.overlap, 0.0, 1.0) * agreement_now(problem, state)
    np.maximum.at(shared, (problem.source, problem.target), overlap)
    return np.maximum(shared, shared.T)


def novel_scores(problem: Problem, choice: Options, shared: Array) -> Array:
    """(1 + a,) scores of the present place and of every proposal, repetitions left out."""
    inside, outside = choice.inside, choice.outside
    repeats = shared[np.ix_(inside, inside)] * shared[np.ix_(outside, outside)]
    order = np.argsort(-choice.gains, axis=1, kind="stable")[:, :MAX_LINKS]
    gains = np.take_along_axis(choice.gains, order, axis=1)
    repeats = repeats[order[:, :, None], order[:, None, :]]
    links = order.shape[1]
    earlier = np.tri(links, links, -1, dtype=bool)
    novelty = np.where(earlier, 1.0 - repeats, 1.0).prod(axis=2)
    return np.asarray((gains * novelty).sum(axis=1) - problem.join_cost)
