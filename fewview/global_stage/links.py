"""The links of a component: of each pair the candidate that says most for where its scans stand.

Parts of a component that no candidate joins stand together by what all of their scans say of each
other; the pair of scans that says most gets a candidate of its own for it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csgraph, csr_array

from fewview.geometry import se3
from fewview.global_stage.model import Problem
from fewview.global_stage.placement import State, agreement_now
from fewview.global_stage.places import Potentials
from fewview.global_stage.pose_graph import Edge
from fewview.types import Array, BoolArray, PairResult


def selected(
    problem: Problem, state: State, pairs: Sequence[PairResult], group: Sequence[int]
) -> list[Edge]:
    """The candidate of each pair of a group that says most for the state, if any agrees."""
    worth = agreement_now(problem, state) * problem.evidence
    worth *= np.isin(problem.source, group)
    best: dict[int, int] = {}
    for c in np.flatnonzero(worth > 0.0):
        pair = int(problem.pair[c])
        if pair not in best or worth[c] > worth[best[pair]]:
            best[pair] = int(c)
    return [_edge(pairs[pair], int(problem.rank[c])) for pair, c in sorted(best.items())]


def bridges(
    state: State,
    pairs: Sequence[PairResult],
    group: Sequence[int],
    links: Sequence[Edge],
    strength: Array,
    probability: Array,
    potentials: Potentials,
) -> list[Edge]:
    """New candidates that join the parts of a group which ``links`` leave apart.

    Args:
        state: where the scans stand.
        pairs: all pair results.
        group: the scans of a component.
        links: its selected candidates.
        strength: (n, n) potentials of the pairs that stand together.
        probability: (n,) of each scan there.
        potentials: make the candidates.
    """
    ranks = {(pair.source, pair.target): len(pair.candidates) for pair in pairs}
    linked = np.zeros_like(strength, dtype=bool)
    for link in links:
        linked[link.source, link.target] = True
    open_pairs = np.isin(np.arange(len(strength)), group)
    open_pairs = open_pairs[:, None] & open_pairs & np.triu(np.ones_like(linked), 1)
    found: list[Edge] = []
    for i, j in _strongest_first(strength, open_pairs):
        _, part = csgraph.connected_components(csr_array(linked), directed=False)
        if part[i] != part[j]:
            motion = se3.inverse(state.pose[j]) @ state.pose[i]
            chance = float(min(probability[i], probability[j]))
            candidate = potentials.candidate(i, j, motion, ranks.get((i, j), 0), chance)
            found.append(Edge(i, j, candidate))
            linked[i, j] = True
    return found


def _strongest_first(strength: Array, among: BoolArray) -> list[tuple[int, int]]:
    rows = np.argwhere(among)
    order = np.argsort(-strength[among], kind="stable")
    return [(int(i), int(j)) for i, j in rows[order]]


def _edge(pair: PairResult, rank: int) -> Edge:
    candidate = next(c for c in pair.candidates if c.rank == rank)
    return Edge(pair.source, pair.target, candidate)
