"""What else the scans could be: the runners-up of the discrete stage in the answer's worlds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from fewview.geometry import se3
from fewview.global_stage.comparison import Answer, moved_scans, says_new
from fewview.global_stage.model import Problem
from fewview.global_stage.placement import State, gain_matrix
from fewview.global_stage.world import find_world
from fewview.types import (
    Alternative,
    AlternativePlace,
    Array,
    IntArray,
    Levelling,
    ScanPlacement,
)

LEAST_ODDS = 0.01
"""Alternatives of smaller odds are not worth a user's time."""


def alternatives(
    problem: Problem,
    answer: State,
    found: Sequence[Answer],
    placements: Sequence[ScanPlacement],
    levellings: Sequence[Levelling],
    count: int,
) -> tuple[Alternative, ...]:
    """The probable labellings that say something which the answer does not.

    Args:
        problem: the candidates.
        answer: the labelling that the placements come from; doubtful scans are dropped.
        found: distinct labellings, best first.
        placements: the answer.
        levellings: one per scan.
        count: alternatives at most.
    """
    margins = [found[0].score - other.score for other in found]
    others = [
        Alternative(margin, _places(problem, answer, other.state, placements, levellings))
        for margin, other in zip(margins, found, strict=True)
        if margin <= -math.log(LEAST_ODDS) and says_new(problem, other.state, [answer])
    ]
    return tuple(others[:count])


def _places(
    problem: Problem,
    answer: State,
    state: State,
    placements: Sequence[ScanPlacement],
    levellings: Sequence[Levelling],
) -> tuple[AlternativePlace, ...]:
    """Of the scans that stand otherwise than in the answer."""
    moved = np.isin(np.arange(problem.scans), moved_scans(problem, state, answer))
    known = {i: p for i, p in enumerate(placements) if p.placed and not moved[i]}
    own = 1 + max((p.component for p in placements if p.component is not None), default=-1)
    gains = gain_matrix(problem, state)
    places: list[AlternativePlace] = []
    for label in np.unique(state.component[moved]):
        members = np.flatnonzero(state.component == label)
        anchors = {i: known[i] for i in members.tolist() if i in known}
        if anchors:
            asked = members[moved[members]]
            places += [_beside(state, scan, anchors, gains[scan]) for scan in asked.tolist()]
        elif len(members) > 1:
            places += _apart(state, members, levellings, own)
            own += 1
        else:
            places.append(AlternativePlace(int(members[0]), None, None))
    return tuple(sorted(places, key=lambda place: place.scan))


def _beside(
    state: State, scan: int, anchors: Mapping[int, ScanPlacement], gains: Array
) -> AlternativePlace:
    """In the world of the anchor that says most for the place."""
    anchor = max(anchors, key=lambda i: gains[i])
    anchor_T_scan = se3.inverse(state.pose[anchor]) @ state.pose[scan]
    placement = anchors[anchor]
    assert placement.world_T_scan is not None
    return AlternativePlace(scan, placement.component, placement.world_T_scan @ anchor_T_scan)


def _apart(
    state: State, members: IntArray, levellings: Sequence[Levelling], component: int
) -> list[AlternativePlace]:
    """In a world of their own."""
    poses = {int(i): state.pose[i] for i in members}
    world = find_world(poses, levellings).world_T_frame
    return [AlternativePlace(i, component, world @ pose) for i, pose in poses.items()]
