"""What all scans of a place say of it: the second half of the discrete problem.

Candidates come from pairs, and `model` lets them vote. Any two scans that an arrangement puts into
one frame can be asked as well, whether a candidate of theirs agrees or not: each may stand in what
the other saw to be free, show what the other shows, or what the other's completed room foresees.
The log posterior of an arrangement relative to "nothing is joined" then is

    S' = sum over pairs within a component of phi_ij(T_ij) + joins * b,

with the learned potential phi of the relative pose, in which the votes log(1 + sum r a) of the
pair's candidates are one quantity among others, and the log odds b of a join. Beside the places
that candidates propose there are those where the aligner lays a block, drawn as one, over all other
scans of a component, drawn as one; what it says of a place, whoever proposed it, is added to the
log odds of the place. No place brings a pair back to where the user says that it does not stand.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from fewview.geometry import se3
from fewview.global_stage.model import Problem
from fewview.global_stage.placement import Crossing, State, pair_gains
from fewview.types import Array, BoolArray, IntArray, PoseCandidate

SAME_RAD = np.radians(15.0)
SAME_M = 0.3
"""Places of a block closer than both are one place."""

BEHIND = 8.0
"""A place that falls so far behind the best of its component, or behind none, is given up before
all pairs are asked: of 270 places of 20 real scans that ended within 5, none was ever behind by
more than 6."""

MOST = 10
"""Different places in one component that candidates may propose, the strongest ones."""


class Overlays(Protocol):
    """What `fewview.together.Overlay` answers."""

    def proposals(self) -> Array:
        """(P, 4, 4) motions of the one group over the other, likeliest first."""

    def log_odds(self, motions: Array) -> Array:
        """(K,) what the drawings add to the log odds of (K, 4, 4) motions."""


class Potentials(Protocol):
    """What `fewview.together.Together` answers."""

    @property
    def join(self) -> float:
        """b of the module's formula."""

    def potential(self, source: int, target: int, poses: Array, gain: Array) -> Array:
        """(K,) phi of (K, 4, 4) poses target_T_source with (K,) votes of the candidates."""

    def overlay(self, moving: Mapping[int, Array], fixed: Mapping[int, Array]) -> Overlays:
        """The scans ``moving``, drawn as one, over the scans ``fixed``, drawn as one."""

    def candidate(
        self, source: int, target: int, pose: Array, rank: int, probability: float
    ) -> PoseCandidate:
        """A candidate (4, 4) target_T_source for a pair that none of its own joins."""


@dataclass(frozen=True)
class Places:
    """Where a block could stand; log odds are relative to a frame of its own.

    Attributes:
        stay: log odds of its present place; 0 when it is alone there, -inf when a veto forbids it.
        score: (a,) log odds of the other places, no two of them the same; hopeless ones are left
            out.
        motion: (a, 4, 4) that carries the block there.
        component: (a,) label of the frame it enters.
    """

    stay: float
    score: Array
    motion: Array
    component: IntArray


@dataclass(frozen=True)
class Created:
    """A pair of scans that places of a block put into one frame.

    Attributes:
        source, target: indices of the scans, the source's the smaller.
        here: (K,) which of the places do.
        poses: (K, 4, 4) target_T_source there.
        votes: (K,) what the candidates of the pair add there.
    """

    source: int
    target: int
    here: IntArray
    poses: Array
    votes: Array

    def among(self, places: BoolArray) -> Created:
        """The same at some of all (a,) places alone."""
        kept = places[self.here]
        return replace(self, here=self.here[kept], poses=self.poses[kept], votes=self.votes[kept])


def places(
    problem: Problem,
    state: State,
    block: BoolArray,
    potentials: Potentials,
    asked: BoolArray | None = None,
) -> Places:
    """Every place that candidates or the aligner propose for a block, judged by all scans there.

    Args:
        problem: the candidates.
        state: the present labelling; all scans of ``block`` are in one component.
        block: (n,) the scans that move together, not all scans.
        potentials: of pairs of scans.
        asked: (n, n) pairs of scans that have a say; all when not given.
    """
    home = int(state.component[block][0])
    overlays = overlaid(state, block, potentials)
    motions, frames = proposed(problem, state, block, overlays)
    score: Array = np.full(len(motions), potentials.join)
    for label, overlay in overlays.items():
        here = frames == label
        score[here] += overlay.log_odds(motions[here])
    for everywhere in created(problem, state, block, motions, frames, asked):
        pair = everywhere.among(score > -np.inf)
        if not len(pair.here):
            continue
        score[pair.here] += potentials.potential(pair.source, pair.target, pair.poses, pair.votes)
        score[pair.here[_vetoed(problem, pair)]] = -np.inf
        best = score[pair.here].max(initial=0.0)
        behind = pair.here[score[pair.here] < best - BEHIND]
        score[behind[behind > 0]] = -np.inf
    alone = not np.any((state.component == home) & ~block)
    others = 1 + np.flatnonzero(score[1:] > -np.inf)
    stay = 0.0 if alone else float(score[0])
    return Places(stay, score[others], motions[others], frames[others])


def overlaid(state: State, block: BoolArray, potentials: Potentials) -> dict[int, Overlays]:
    """A block over all other scans of each component, by the component's label."""
    moving = {int(i): state.pose[i] for i in np.flatnonzero(block)}
    out = {}
    for label in np.unique(state.component[~block]).tolist():
        members = np.flatnonzero((state.component == label) & ~block).tolist()
        out[label] = potentials.overlay(moving, {j: state.pose[j] for j in members})
    return out


def proposed(
    problem: Problem, state: State, block: BoolArray, overlays: Mapping[int, Overlays]
) -> tuple[Array, IntArray]:
    """(a, 4, 4) motions of a block and the (a,) frames that they lead to, the present place first,
    then of each component what the strongest candidates and the aligner propose; all different."""
    crossing = Crossing.of(problem, state, block)
    frame = state.component[crossing.fixed]
    order = np.argsort(-problem.evidence[crossing.candidates], kind="stable")
    found, labels = [np.eye(4)[None]], [int(state.component[block][0])]
    for label, overlay in overlays.items():
        own = order[frame[order] == label]
        agree = crossing.agreement(problem, state, crossing.implied[own], frame[own])
        votes = pair_gains(problem, crossing.candidates, agree).sum(axis=1)
        ranked = crossing.implied[own][np.argsort(-votes, kind="stable")]
        strongest = ranked[_different(state, block, ranked, np.full(len(ranked), label))[:MOST]]
        above = overlay.proposals()
        found += [strongest, above]
        labels += [label] * (len(strongest) + len(above))
    motions, frames = np.concatenate(found), np.array(labels, dtype=np.int64)
    kept = _different(state, block, motions, frames)
    return motions[kept], frames[kept]


def created(
    problem: Problem,
    state: State,
    block: BoolArray,
    motions: Array,
    frames: IntArray,
    asked: BoolArray | None = None,
) -> Iterator[Created]:
    """The pairs of scans that (a, 4, 4) motions of a block into (a,) frames put together, of those
    ``asked``."""
    crossing = Crossing.of(problem, state, block)
    agree = crossing.agreement(problem, state, motions, frames)
    votes = pair_gains(problem, crossing.candidates, agree)
    first = crossing.first_of_pairs(problem)
    pairs = zip(crossing.moving[first].tolist(), crossing.fixed[first].tolist(), strict=True)
    column = {pair: q for q, pair in enumerate(pairs)}
    for j in np.flatnonzero(~block).tolist():
        here = np.flatnonzero(frames == state.component[j])
        speaking = block if asked is None else block & asked[j]
        for i in np.flatnonzero(speaking).tolist() if len(here) else ():
            pose = se3.inverse(state.pose[j]) @ motions[here] @ state.pose[i]
            vote = votes[here, column[i, j]] if (i, j) in column else np.zeros(len(here))
            if i < j:
                yield Created(i, j, here, pose, vote)
            else:
                yield Created(j, i, here, se3.inverse(pose), vote)


def _vetoed(problem: Problem, pair: Created) -> BoolArray:
    """(K,) which of the poses the user has ruled out."""
    wrong = problem.vetoed.get((pair.source, pair.target), np.empty((0, 4, 4)))
    return np.asarray(_same(pair.poses[:, None], wrong).any(axis=1))


def _different(state: State, block: BoolArray, motions: Array, frames: IntArray) -> IntArray:
    """Indices of motions that do not lead to the place of one before them."""
    carried = motions @ state.pose[np.argmax(block)]
    same = _same(carried[:, None], carried) & (frames[:, None] == frames)
    kept: list[int] = []
    for k in range(len(motions)):
        if not same[k, kept].any():
            kept.append(k)
    return np.array(kept, dtype=np.int64)


def _same(one: Array, other: Array) -> BoolArray:
    """(...) which of (..., 4, 4) poses, broadcast against each other, are one place."""
    turn, shift = se3.distance(one, other)
    return np.asarray((turn < SAME_RAD) & (shift < SAME_M))
