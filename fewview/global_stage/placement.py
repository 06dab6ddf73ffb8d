"""A labelling of the scans, and how well every place that candidates propose for a block fits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fewview.geometry import se3
from fewview.global_stage.model import Problem
from fewview.types import Array, BoolArray, IntArray

KERNEL_RADIUS = 2.0
"""Agreement falls to zero at this multiple of the tolerance."""

MAX_PROPOSALS = 128
"""Candidates that may propose a place for a block, strongest first; all of them judge it."""


@dataclass
class State:
    """A labelling.

    Attributes:
        pose: (n, 4, 4) frame_T_scan.
        component: (n,) label of the frame; a scan alone in its frame is not placed.
    """

    pose: Array
    component: IntArray

    @classmethod
    def apart(cls, scans: int) -> State:
        """Every scan alone in a frame of its own."""
        return cls(np.tile(np.eye(4), (scans, 1, 1)), np.arange(scans, dtype=np.int64))

    def copy(self) -> State:
        """A labelling that can be changed on its own."""
        return State(self.pose.copy(), self.component.copy())

    def detach(self, block: BoolArray) -> None:
        """Give the scans of ``block`` a frame of their own."""
        unused = np.setdiff1d(np.arange(len(self.component) + 1), self.component)
        self.component[block] = unused[0]

    def move(self, block: BoolArray, motion: Array, component: int) -> None:
        """Move ``block`` rigidly by ``motion`` into the frame ``component``."""
        moved = motion @ self.pose[block]
        moved[:, :3, :3] = se3.nearest_rotation(moved[:, :3, :3])
        self.pose[block] = moved
        self.component[block] = component


@dataclass(frozen=True)
class Options:
    """Where a block could go; scores are relative to leaving it in a frame of its own.

    Attributes:
        stay: score of its present place; 0 when it is alone there.
        score: (a,) of each proposal.
        motion: (a, 4, 4) that carries the block there.
        component: (a,) label of the frame it enters.
        same: (a,) whether it proposes the present place, within the kernel's radius.
        best: (a,) whether no proposal of a higher score is for this place.
        gains: (1 + a, q) what each pair of scans adds, in the present place and in each proposal.
        inside, outside: (q,) the scans of those pairs.
    """

    stay: float
    score: Array
    motion: Array
    component: IntArray
    same: BoolArray
    best: BoolArray
    gains: Array
    inside: IntArray
    outside: IntArray


@dataclass(frozen=True)
class Crossing:
    """The c candidates between a block and the other scans.

    Attributes:
        candidates: (c,) their indices, sorted by pair.
        implied: (c, 4, 4) motions of the block that satisfy each.
        moving, fixed: (c,) their scans inside and outside the block.
    """

    candidates: IntArray
    implied: Array
    moving: IntArray
    fixed: IntArray

    @classmethod
    def of(cls, problem: Problem, state: State, block: BoolArray) -> Crossing:
        """Find them and what they ask of the block."""
        candidates = np.flatnonzero(block[problem.source] != block[problem.target])
        source, target = problem.source[candidates], problem.target[candidates]
        forward = block[source]
        moving, fixed = np.where(forward, source, target), np.where(forward, target, source)
        fixed_T_moving = np.where(
            forward[:, None, None],
            problem.motion[candidates],
            problem.inverse_motion[candidates],
        )
        implied = state.pose[fixed] @ fixed_T_moving @ se3.inverse(state.pose[moving])
        return cls(candidates, implied, moving, fixed)

    def agreement(self, problem: Problem, state: State, motions: Array, frames: IntArray) -> Array:
        """(a, c) how well (a, 4, 4) motions into (a,) frames agree with each candidate."""
        moving, fixed = state.pose[self.moving, :3, 3], state.pose[self.fixed, :3, 3]
        agree = agreement(problem, motions, self.implied, moving, fixed)
        return np.asarray(agree * (frames[:, None] == state.component[self.fixed]))

    def first_of_pairs(self, problem: Problem) -> IntArray:
        """(q,) position of the first candidate of every pair."""
        return np.flatnonzero(np.diff(problem.pair[self.candidates], prepend=-1))


def options(problem: Problem, state: State, block: BoolArray) -> Options:
    """Evaluate every place that a candidate between ``block`` and the other scans proposes.

    Args:
        problem: the candidates.
        state: the present labelling; all scans of ``block`` are in one component.
        block: (n,) the scans that move together.
    """
    home = int(state.component[block][0])
    alone = not np.any((state.component == home) & ~block)
    crossing = Crossing.of(problem, state, block)
    evidence = problem.evidence[crossing.candidates]
    order = np.argsort(-evidence, kind="stable")[:MAX_PROPOSALS]
    motions = np.concatenate([np.eye(4)[None], crossing.implied[order]])
    frames = np.concatenate([[home], state.component[crossing.fixed[order]]])
    agree = crossing.agreement(problem, state, motions, frames)
    gains = pair_gains(problem, crossing.candidates, agree)
    score = gains.sum(axis=1) - problem.join_cost
    rank = np.empty(len(order), dtype=np.int64)
    rank[np.argsort(-score[1:], kind="stable")] = np.arange(len(order))
    first = crossing.first_of_pairs(problem)
    among = agree[:, order] > 0.0
    return Options(
        stay=0.0 if alone else float(score[0]),
        score=score[1:],
        motion=motions[1:],
        component=frames[1:],
        same=among[0],
        best=~np.any(among[1:] & (rank < rank[:, None]), axis=1),
        gains=gains,
        inside=crossing.moving[first],
        outside=crossing.fixed[first],
    )


def agreement(
    problem: Problem, motions: Array, implied: Array, moving: Array, fixed: Array
) -> Array:
    """How well world motions of a block agree with the motions that candidates ask for.

    Args:
        problem: for the tolerances.
        motions: (a, 4, 4) tried.
        implied: (c, 4, 4) that would satisfy each candidate exactly.
        moving: (c, 3) camera position of the candidate's scan inside the block.
        fixed: (c, 3) camera position of its other scan.

    Returns:
        (a, c) in 0..1: Tukey's biweight of the rotation and of the mean squared displacement of
        the two cameras as each sees the other, so that swapping source and target changes nothing.
    """
    trace = motions[:, :3, :3].reshape(-1, 9) @ implied[:, :3, :3].reshape(-1, 9).T
    seen = _displacement2(motions, implied, moving)
    seeing = _displacement2(se3.inverse(motions), se3.inverse(implied), fixed)
    return _biweight(problem, trace, 0.5 * (seen + seeing))


def _displacement2(motions: Array, implied: Array, points: Array) -> Array:
    """(a, c) squared distances |R x + t - q|^2 between the images of (c, 3) points x, expanded
    so that everything is a matrix product; q are their images under ``implied``."""
    turn, shift = motions[:, :3, :3], motions[:, :3, 3]
    asked = se3.transform(implied, points[:, None])[:, 0]
    outer = (asked[:, :, None] * points[:, None, :]).reshape(-1, 9)
    shift_back = np.squeeze(shift[:, None] @ turn, axis=1)
    cross = shift_back @ points.T - shift @ asked.T - turn.reshape(-1, 9) @ outer.T
    constant = np.square(points).sum(-1) + np.square(asked).sum(-1)
    return np.asarray(2.0 * cross + constant + np.square(shift).sum(-1)[:, None])


def pair_gains(problem: Problem, candidates: IntArray, agree: Array) -> Array:
    """log(1 + sum r a) of each pair: (a, c) agreements of sorted ``candidates`` to (a, pairs)."""
    if not len(candidates):
        return np.zeros((len(agree), 0))
    pair = problem.pair[candidates]
    starts = np.flatnonzero(np.diff(pair, prepend=-1))
    return np.asarray(
        np.log1p(np.add.reduceat(agree * problem.evidence[candidates], starts, axis=1))
    )


def agreement_now(problem: Problem, state: State) -> Array:
    """(m,) agreement of every candidate with the state; 0 between components."""
    out = np.zeros(len(problem.source))
    inside = np.flatnonzero(state.component[problem.source] == state.component[problem.target])
    pose_s, pose_t = state.pose[problem.source[inside]], state.pose[problem.target[inside]]
    out[inside] = likeness(problem, se3.inverse(pose_t) @ pose_s, problem.motion[inside])
    return out


def likeness(problem: Problem, one: Array, other: Array) -> Array:
    """How alike two relative poses are, as `agreement` measures it.

    Args:
        problem: for the tolerances.
        one, other: (..., 4, 4) target_T_source, broadcast against each other.

    Returns:
        (...) in 0..1.
    """
    trace = np.einsum("...ij,...ij->...", one[..., :3, :3], other[..., :3, :3])
    seen = np.square(one[..., :3, 3] - other[..., :3, 3]).sum(-1)
    back, other_back = se3.inverse(one)[..., :3, 3], se3.inverse(other)[..., :3, 3]
    seeing = np.square(back - other_back).sum(-1)
    return _biweight(problem, trace, 0.5 * (seen + seeing))


def _biweight(problem: Problem, trace: Array, distance2: Array) -> Array:
    """Tukey's biweight of a rotation, given by its trace, and a squared distance."""
    ratio2 = (3.0 - trace) / problem.max_chord2 + distance2 / problem.max_distance2
    return np.asarray(np.square(np.maximum(1.0 - ratio2 / KERNEL_RADIUS**2, 0.0)))


def gain_matrix(problem: Problem, state: State) -> Array:
    """(n, n) symmetric: what each pair adds to the objective."""
    everything = np.arange(len(problem.source))
    gains = pair_gains(problem, everything, agreement_now(problem, state)[None])[0]
    first = np.flatnonzero(np.diff(problem.pair, prepend=-1))
    out = np.zeros((problem.scans, problem.scans))
    np.add.at(out, (problem.source[first], problem.target[first]), gains)
    return out + out.T


def objective(problem: Problem, state: State) -> float:
    """S of `model`: the log posterior relative to every scan apart."""
    joins = problem.scans - len(np.unique(state.component))
    return float(0.5 * gain_matrix(problem, state).sum() - joins * problem.join_cost)
