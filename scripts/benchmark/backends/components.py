"""Pose graphs over what the pairs connect: one component at a time, the largest first."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import networkx as nx

from benchmark.backends.pose_graphs import gnc, robust_rec
from benchmark.methods.interface import Answer, Placement
from fewview.types import Frame

OPTIMISERS = {"robust_rec": robust_rec, "gnc": gnc}


def solve(
    names: Sequence[str],
    frame: Callable[[int], Frame],
    answers: Mapping[tuple[int, int], Answer],
    optimiser: str,
    min_score: float,
) -> list[Placement | None]:
    """Placements of all scans; scans that no edge reaches have none.

    Args:
        names: of the scans.
        frame: pixels by index, not looked at.
        answers: of a method with one candidate, by indices (source, target).
        optimiser: key of `OPTIMISERS`.
        min_score: edges with a lower score are dropped.
    """
    edges = {
        pair: answer.candidates[0]
        for pair, answer in answers.items()
        if answer.candidates and answer.candidates[0].score >= min_score
    }
    groups = [sorted(group) for group in nx.connected_components(nx.Graph(edges.keys()))]
    placements: list[Placement | None] = [None] * len(names)
    for component, scans in enumerate(sorted(groups, key=lambda g: (-len(g), g[0]))):
        inside = {pair: edge for pair, edge in edges.items() if pair[0] in scans}
        for scan, pose in OPTIMISERS[optimiser](scans, inside).items():
            placements[scan] = Placement(component, pose)
    return placements
