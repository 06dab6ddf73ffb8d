"""All pairs to one answer: discrete choice, pose graph and world frame per component."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fewview.config import GlobalConfig
from fewview.geometry import se3
from fewview.global_stage import discrete, reasons
from fewview.global_stage.alternatives import alternatives
from fewview.global_stage.arrangement import Arranging
from fewview.global_stage.belief import drop_doubtful
from fewview.global_stage.comparison import Answer
from fewview.global_stage.links import bridges, selected
from fewview.global_stage.model import Problem, build
from fewview.global_stage.placement import State, objective
from fewview.global_stage.places import Potentials
from fewview.global_stage.pose_graph import Edge, optimise
from fewview.global_stage.world import find_world
from fewview.types import (
    Array,
    CandidateOrigin,
    Component,
    EdgeReport,
    GlobalSolution,
    Levelling,
    PairResult,
    ScanPlacement,
)


def solve(
    names: Sequence[str],
    levellings: Sequence[Levelling],
    pairs: Sequence[PairResult],
    config: GlobalConfig,
    seed: int,
    fixed: Mapping[int, Array] | None = None,
    potentials: Potentials | None = None,
) -> GlobalSolution:
    """Choose at most one candidate per pair and pose every scan that can be trusted.

    Args:
        names: of the scans.
        levellings: one per scan.
        pairs: results of any pairs of scans, each at most once.
        config: settings of the stage.
        seed: of the discrete search.
        fixed: scan index -> (4, 4) world_T_scan that is kept as it is; ``pairs`` hold the told
            candidates between these scans.
        potentials: what any two scans say of their places; without them the candidates alone
            decide.

    Returns:
        Components of two scans or more, or with a fixed one, largest first, each in its own world
        frame; scans that no component holds are unplaced, with the reason. Alternatives are what
        else they could be.
    """
    fixed = fixed or {}
    problem = build(len(names), pairs, config, fixed)
    decided = _decide(problem, config, seed, potentials)
    groups = _groups(decided.state, fixed)
    links = {group: _links(problem, decided, pairs, group, potentials) for group in groups}
    parts = [_place(decided.state, links[group], levellings, group, fixed) for group in groups]
    placements = [
        ScanPlacement(
            name, None, None, 0.0, reasons.why_unplaced(names, pairs, i, config.min_probability)
        )
        for i, name in enumerate(names)
    ]
    for index, part in enumerate(parts):
        for scan, pose in part.world_T_scan.items():
            probability = 1.0 if scan in fixed else float(decided.probability[scan])
            placements[scan] = ScanPlacement(names[scan], index, pose, probability, None)
    return GlobalSolution(
        placements=tuple(placements),
        components=tuple(
            Component(group, part.world, reasons.nearest_link(names, pairs, group))
            for group, part in zip(groups, parts, strict=True)
        ),
        selected={(e.source, e.target): e.rank for part in parts for e in part.edges},
        initial_world_T_scan={i: pose for part in parts for i, pose in part.initial.items()},
        edges=tuple(edge for part in parts for edge in part.edges),
        alternatives=alternatives(
            problem, decided.state, decided.answers, placements, levellings, config.alternatives
        ),
        found={
            (link.source, link.target): link.candidate
            for group in groups
            for link in links[group]
            if link.candidate.origin is CandidateOrigin.TOGETHER
        },
    )


@dataclass(frozen=True)
class _Decision:
    """Where the scans stand, how probable that is (n,), and the best answers before doubtful scans
    were set apart."""

    state: State
    probability: Array
    answers: Sequence[Answer]
    strength: Array | None


def _decide(
    problem: Problem, config: GlobalConfig, seed: int, potentials: Potentials | None
) -> _Decision:
    """By the candidates, and what they leave open, by all scans that a place puts together."""
    count, least = 1 + config.alternatives, config.min_probability
    found = discrete.search(problem, config.restarts, seed, count)
    state = found[0].copy()
    probability = drop_doubtful(problem, state, least).probability
    answers = [Answer(one, objective(problem, one)) for one in found]
    if potentials is None:
        return _Decision(state, probability, answers, None)
    arranging = Arranging(problem, state, probability, potentials)
    if arranging.open:
        answers = arranging.search(seed, count)
        state = answers[0].state.copy()
        probability = arranging.drop_doubtful(state, least)
    return _Decision(state, probability, answers, arranging.matrix(state))


def _links(
    problem: Problem,
    decided: _Decision,
    pairs: Sequence[PairResult],
    group: Sequence[int],
    potentials: Potentials | None,
) -> list[Edge]:
    """The selected candidates of a component, and new ones where they do not hold it together."""
    links = selected(problem, decided.state, pairs, group)
    if potentials is None or decided.strength is None:
        return links
    return links + bridges(
        decided.state, pairs, group, links, decided.strength, decided.probability, potentials
    )


@dataclass(frozen=True)
class _Part:
    """A component in its world frame; poses by scan index, before and after the pose graph."""

    world_T_scan: Mapping[int, Array]
    initial: Mapping[int, Array]
    edges: tuple[EdgeReport, ...]
    world: str


def _groups(state: State, fixed: Collection[int]) -> list[tuple[int, ...]]:
    """Scans of every component of two or more or with a fixed one, largest first, ties by the
    smallest index."""
    members = [np.flatnonzero(state.component == label) for label in np.unique(state.component)]
    groups = [
        tuple(int(i) for i in group) for group in members if len(group) > 1 or group[0] in fixed
    ]
    return sorted(groups, key=lambda group: (-len(group), group[0]))


def _place(
    state: State,
    edges: Sequence[Edge],
    levellings: Sequence[Levelling],
    group: Sequence[int],
    fixed: Mapping[int, Array],
) -> _Part:
    """Optimise one component, and level it unless fixed poses say where it is."""
    if known := {scan: fixed[scan] for scan in group if scan in fixed}:
        start = _in_given_world({scan: state.pose[scan] for scan in group}, known)
        given = optimise(start, edges, known)
        return _Part({**given.pose, **known}, {**start, **known}, given.edges, "given")
    initial = {scan: state.pose[scan] for scan in group}
    result = optimise(initial, edges)
    world = find_world(result.pose, levellings)
    return _Part(
        world_T_scan={scan: world.world_T_frame @ result.pose[scan] for scan in group},
        initial={scan: world.world_T_frame @ initial[scan] for scan in group},
        edges=result.edges,
        world=world.kind,
    )


def _in_given_world(
    frame_T_scan: Mapping[int, Array], known: Mapping[int, Array]
) -> dict[int, Array]:
    """(4, 4) world_T_scan of a component, where ``known`` ones are as given, made exactly rigid."""
    rigid = {scan: se3.rigid(pose) for scan, pose in known.items()}
    first = min(known)
    world_T_frame = rigid[first] @ se3.inverse(frame_T_scan[first])
    return {scan: world_T_frame @ pose for scan, pose in frame_T_scan.items()} | rigid
