"""The poses of a solution refined by the surfaces of their scans."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from fewview.config import GlobalConfig
from fewview.global_stage.pose_graph import Edge
from fewview.global_stage.registration import register
from fewview.global_stage.world import find_world
from fewview.types import (
    Array,
    CompletedScan,
    Component,
    GlobalSolution,
    PairResult,
    ScanPlacement,
)


def refine(
    solution: GlobalSolution,
    pairs: Sequence[PairResult],
    scans: Sequence[CompletedScan],
    config: GlobalConfig,
    fixed: Collection[int] = (),
) -> GlobalSolution:
    """Register the scans of every component with each other, and level it again.

    Args:
        solution: of `solve`.
        pairs: the results that it was solved from.
        scans: all of them, in order.
        config: settings of the stage.
        fixed: scans that stay where they are.

    Returns:
        The solution with the poses that its held-out surface points prefer.
    """
    if not config.registration:
        return solution
    edges = _edges(solution, pairs)
    parts = [_refined(solution, part, scans, edges, config, fixed) for part in solution.components]
    poses = {i: pose for part in parts for i, pose in part.world_T_scan.items()}
    return replace(
        solution,
        placements=tuple(
            replace(placement, world_T_scan=poses.get(i))
            for i, placement in enumerate(solution.placements)
        ),
        components=tuple(part.component for part in parts),
        initial_world_T_scan={i: pose for part in parts for i, pose in part.initial.items()},
    )


@dataclass(frozen=True)
class _Part:
    """A component with its poses, and those before the pose graph, in its new world frame."""

    component: Component
    world_T_scan: Mapping[int, Array]
    initial: Mapping[int, Array]


def _refined(
    solution: GlobalSolution,
    component: Component,
    scans: Sequence[CompletedScan],
    edges: Sequence[Edge],
    config: GlobalConfig,
    fixed: Collection[int],
) -> _Part:
    start = {i: _pose(solution.placements[i]) for i in component.scans}
    initial = {i: solution.initial_world_T_scan[i] for i in component.scans}
    inside = [edge for edge in edges if edge.source in start]
    held = set(fixed) & set(component.scans) or {component.scans[0]}
    result = register(start, scans, inside, held, config.plane_factors)
    judged = replace(component, registration=result.outcome)
    if result.outcome is None or not result.outcome.accepted:
        return _Part(judged, start, initial)
    if not held.isdisjoint(fixed):
        return _Part(judged, result.pose, initial)
    world = find_world(result.pose, [scan.levelling for scan in scans])
    return _Part(
        replace(judged, world=world.kind),
        {i: world.world_T_frame @ pose for i, pose in result.pose.items()},
        {i: world.world_T_frame @ pose for i, pose in initial.items()},
    )


def _edges(solution: GlobalSolution, pairs: Sequence[PairResult]) -> list[Edge]:
    """The selected candidates of all components."""
    by_scans = {(pair.source, pair.target): pair for pair in pairs}
    return [
        Edge(i, j, next(c for c in by_scans[i, j].candidates if c.rank == rank))
        for (i, j), rank in solution.selected.items()
    ]


def _pose(placement: ScanPlacement) -> Array:
    if placement.world_T_scan is None:
        raise ValueError(f"scan {placement.name} of a component has no pose")
    return placement.world_T_scan
