"""Places that a scan may take in the frame of a root scan, and what pairs of places are worth.

The first label of every scan is "elsewhere", outside the root's component. Scans that end there
are a smaller problem of the same kind, solved by itself until nothing joins.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from fewview.geometry import se3
from fewview.global_stage.discrete import spanning_tree
from fewview.global_stage.model import Problem
from fewview.global_stage.placement import State, likeness, pair_gains
from fewview.types import Array, BoolArray, IntArray

TREES = 96
"""Perturbed spanning trees that propose places."""
MAX_PLACES = 24
"""Places kept for a scan, those that most trees propose."""
SAME_PLACE = 0.8
"""Places this alike, as `likeness` measures it, are one."""
Labeller = Callable[["Network"], IntArray]
"""(n,) label of every scan of a network, 0 for elsewhere; the root has label 1."""


@dataclass(frozen=True)
class Network:
    """A problem of discrete labels.

    Attributes:
        problem: the candidates.
        root: the scan whose frame the places are in.
        place: (n, l, 4, 4) root_T_scan; the first is elsewhere.
        allowed: (n, l).
        unary: (n, l) minus the cost of joining the root's component.
        pair: (e, 2) source and target of pairs with candidates.
        gain: (e, l, l) of the pair's labels, source first.
    """

    problem: Problem
    root: int
    place: Array
    allowed: BoolArray
    unary: Array
    pair: IntArray
    gain: Array

    def score(self, label: IntArray) -> float:
        """The objective of a labelling, its scans elsewhere apart."""
        own = self.unary[np.arange(len(label)), label].sum()
        source, target = self.pair.T
        between = self.gain[np.arange(len(self.pair)), label[source], label[target]].sum()
        return float(own + between)


def solve(problem: Problem, seed: int, labeller: Labeller, hints: tuple[State, ...] = ()) -> State:
    """Label the component of one root after another.

    Args:
        problem: the candidates.
        seed: of the proposals.
        labeller: the method.
        hints: labellings whose places are among the labels.
    """
    state = State.apart(problem.scans)
    rest = np.arange(problem.scans)
    while len(rest) > 1 and len((part := subproblem(problem, rest)).source):
        within = tuple(State(hint.pose[rest], hint.component[rest]) for hint in hints)
        network = build(part, seed, within)
        label = labeller(network)
        inside = label > 0
        members = rest[inside]
        state.pose[members] = network.place[inside, label[inside]]
        state.component[members] = members[0]
        rest = rest[~inside]
    return state


def subproblem(problem: Problem, scans: IntArray) -> Problem:
    """The candidates between some of the scans, which are numbered anew."""
    number = np.full(problem.scans, -1)
    number[scans] = np.arange(len(scans))
    keep = (number[problem.source] >= 0) & (number[problem.target] >= 0)
    return replace(
        problem,
        scans=len(scans),
        source=number[problem.source[keep]],
        target=number[problem.target[keep]],
        pair=problem.pair[keep],
        rank=problem.rank[keep],
        motion=problem.motion[keep],
        probability=problem.probability[keep],
        evidence=problem.evidence[keep],
        overlap=problem.overlap[keep],
    )


def build(problem: Problem, seed: int, hints: tuple[State, ...] = ()) -> Network:
    """Places from spanning trees drawn by their candidates' odds, in the frame of the scan with
    most evidence."""
    weight = np.log(problem.evidence)
    scans = np.arange(problem.scans)
    strength = sum(
        np.bincount(end, weight, problem.scans) for end in (problem.source, problem.target)
    )
    root = int(np.argmax(strength))
    rng = np.random.default_rng(seed)
    trees = [spanning_tree(problem, weight)]
    trees += [spanning_tree(problem, weight + rng.gumbel(size=len(weight))) for _ in range(TREES)]
    proposed = [se3.inverse(tree.pose[root]) @ tree.pose for tree in [*hints, *trees]]
    linked = np.array([tree.component == tree.component[root] for tree in [*hints, *trees]])
    places = [
        _modes(problem, np.array(proposed)[linked[:, i], i], len(hints)) for i in scans.tolist()
    ]
    places[root] = np.eye(4)[None]
    size = 1 + max(map(len, places))
    place = np.tile(np.eye(4), (problem.scans, size, 1, 1))
    allowed = np.zeros((problem.scans, size), dtype=bool)
    allowed[:, 0] = scans != root
    for i, own in enumerate(places):
        place[i, 1 : 1 + len(own)] = own
        allowed[i, 1 : 1 + len(own)] = True
    unary = np.zeros((problem.scans, size))
    unary[scans != root, 1:] = -problem.join_cost
    pair, gain = _pair_gains(problem, place)
    return Network(problem, root, place, allowed, unary, pair, gain)


def _modes(problem: Problem, poses: Array, hints: int) -> Array:
    """Different poses, those with most others beside them first; hints before them."""
    near = likeness(problem, poses[:, None], poses[None])
    votes = near.sum(axis=1)
    votes[:hints] += len(poses)
    kept: list[int] = []
    for k in np.argsort(-votes, kind="stable").tolist():
        if len(kept) < MAX_PLACES and not np.any(near[k, kept] > SAME_PLACE):
            kept.append(k)
    return poses[kept]


def _pair_gains(problem: Problem, place: Array) -> tuple[IntArray, Array]:
    first = np.flatnonzero(np.diff(problem.pair, prepend=-1))
    ends = np.stack([problem.source[first], problem.target[first]], axis=1)
    size = place.shape[1]
    gain = np.zeros((len(first), size, size))
    for k, candidates in enumerate(np.split(np.arange(len(problem.pair)), first[1:])):
        source, target = ends[k]
        error = se3.inverse(place[target, None]) @ place[source, :, None]
        agree = likeness(problem, error[..., None, :, :], problem.motion[candidates])
        own = pair_gains(problem, candidates, agree.reshape(size * size, -1))
        gain[k] = own.reshape(size, size)
    gain[:, 0] = gain[:, :, 0] = 0.0
    return ends, gain
