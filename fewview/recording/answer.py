"""The decision of the global stage, drawn: placed scans, pose graphs, pairs, what is left over."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr

from fewview.geometry import se3
from fewview.recording import layout, scene, tables
from fewview.recording.layout import Eye, Space
from fewview.recording.pictures import Preview
from fewview.types import Array, GlobalSolution, PairResult, PoseCandidate

MAX_OTHER_PAIRS = 8


def log_components(
    stream: rr.RecordingStream,
    scans: Sequence[Preview],
    pairs: Sequence[PairResult],
    solution: GlobalSolution,
) -> list[Space]:
    """Move the placed scans of each component into its world and draw its pose graphs.

    Returns:
        The worlds, largest component first.
    """
    spaces, labels = [], layout.short([scan.name for scan in scans])
    for index, component in enumerate(solution.components):
        poses = _poses(solution, component.scans)
        root = layout.world(index)
        stream.log(root, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for i, world_T_scan in poses.items():
            name = scans[i].name
            stream.log(layout.path(layout.UNPLACED, name), rr.Clear(recursive=True))
            place = layout.path(root, layout.SCANS, name)
            scene.log_points(stream, place, scans[i], world_T_scan)
            scene.log_camera(stream, place, scans[i])
            scene.log_room_shape(stream, place, scans[i].room)
        centres = np.stack([pose[:3, 3] for pose in poses.values()])
        scene.log_labels(stream, layout.path(root, "names"), centres, [labels[i] for i in poses])
        _log_pose_graphs(stream, layout.path(root, "pose_graph"), pairs, solution, poses)
        surface = _joined(poses, [scan.points for scan in scans])
        predicted = _joined(poses, [scan.room.vertices for scan in scans])
        eyes = (
            layout.eye(np.concatenate([points, centres]), centres)
            for points in (surface, np.concatenate([surface, predicted]))
        )
        spaces.append(Space(index, tuple(scans[i].name for i in poses), centres, *eyes))
    return spaces


def log_unplaced(
    stream: rr.RecordingStream, scans: Sequence[Preview], solution: GlobalSolution
) -> Eye | None:
    """Move the scans that were not placed together and write the reasons beside them.

    Returns:
        Where to look at them, or None when there are none.
    """
    left = [(s, p) for s, p in zip(scans, solution.placements, strict=True) if not p.placed]
    for i, (scan, placement) in enumerate(left):
        text = f"{scan.name}: {placement.reason or 'not placed'}"
        shelf = layout.path(layout.UNPLACED, scan.name)
        scene.log_points(stream, shelf, scan, scene.gallery_T_scan(i, scan.levelling))
        scene.log_room_shape(stream, shelf, scan.room)
        scene.log_labels(stream, f"{shelf}/name", np.zeros((1, 3)), [text])
        stream.log("log", rr.TextLog(f"not placed: {text}", level=rr.TextLogLevel.WARN))
    return scene.gallery_eye(len(left)) if left else None


def log_pairs(
    stream: rr.RecordingStream,
    scans: Sequence[Preview],
    pairs: Sequence[PairResult],
    solution: GlobalSolution,
) -> list[tuple[int, int]]:
    """Matches of every selected candidate and of the best few pairs without one.

    Returns:
        Source and target of the pairs drawn, selected ones first, each by falling probability.
    """
    names = [scan.name for scan in scans]
    shown = _telling(pairs, solution.selected)
    for pair, candidate in shown:
        source, target = scans[pair.source], scans[pair.target]
        scene.log_matches(stream, source, target, candidate)
        table = tables.candidates(names, [pair], solution.selected)
        scene.log_text(stream, f"{layout.pair(source.name, target.name)}/candidates", table)
    return [(pair.source, pair.target) for pair, _ in shown]


def _poses(solution: GlobalSolution, members: Sequence[int]) -> dict[int, Array]:
    poses = {i: solution.placements[i].world_T_scan for i in members}
    return {i: pose for i, pose in poses.items() if pose is not None}


def _joined(poses: Mapping[int, Array], clouds: Sequence[Array]) -> Array:
    """(n, 3) the points of some scans in the world."""
    return np.concatenate([se3.transform(p, clouds[i]) for i, p in poses.items()])


def _log_pose_graphs(
    stream: rr.RecordingStream,
    root: str,
    pairs: Sequence[PairResult],
    solution: GlobalSolution,
    after: Mapping[int, Array],
) -> None:
    before = {i: solution.initial_world_T_scan[i] for i in after}
    edges = [e for e in solution.edges if e.source in after and e.target in after]
    weights = [edge.weight for edge in edges]
    for name, poses in (("before", before), ("after", after)):
        lines = [_line(poses, e.source, e.target) for e in edges]
        scene.log_edges(stream, f"{root}/{name}", lines, weights)
    rejected = [
        p
        for p in pairs
        if p.candidates
        and p.source in after
        and p.target in after
        and (p.source, p.target) not in solution.selected
    ]
    lines = [_line(after, p.source, p.target) for p in rejected]
    scene.log_edges(stream, f"{root}/rejected", lines, [_best(p).probability for p in rejected])


def _line(poses: Mapping[int, Array], source: int, target: int) -> Array:
    return np.stack([poses[source][:3, 3], poses[target][:3, 3]])


def _best(pair: PairResult) -> PoseCandidate:
    return max(pair.candidates, key=lambda c: c.probability)


def _telling(
    pairs: Sequence[PairResult], selected: Mapping[tuple[int, int], int]
) -> list[tuple[PairResult, PoseCandidate]]:
    chosen, others = [], []
    for pair in pairs:
        rank = selected.get((pair.source, pair.target))
        if rank is not None:
            chosen.append((pair, next(c for c in pair.candidates if c.rank == rank)))
        elif pair.candidates:
            others.append((pair, _best(pair)))
    for some in (chosen, others):
        some.sort(key=lambda item: -item[1].probability)
    return chosen + others[:MAX_OTHER_PAIRS]
