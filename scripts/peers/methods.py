"""One run of a peer over a set of scans."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import combinations
from typing import Any

import networkx as nx

from fewview.types import Array, Frame
from peers.backends import gnc, robust_rec
from peers.catalogue import Peer
from peers.clouds import Edge, refine
from peers.estimators import ESTIMATORS, Estimator, View

Json = dict[str, Any]


BACKENDS = {"robust_rec": robust_rec, "gnc": gnc}


def run(peer: Peer, names: Sequence[str], frames: Sequence[Frame], jobs: int) -> Json:
    """Reconstruct a set of scans; the answer has the form of a fewview report."""
    estimator = ESTIMATORS[peer.estimator]
    with ThreadPoolExecutor(jobs) as pool:
        views = list(pool.map(estimator.prepare, frames))
        pairs = list(combinations(range(len(views)), 2))
        found = pool.map(lambda pair: _edge(estimator, views[pair[0]], views[pair[1]]), pairs)
        edges = {pair: edge for pair, edge in zip(pairs, found, strict=True) if edge is not None}
    kept = {pair: edge for pair, edge in edges.items() if edge.support >= peer.min_support}
    graph = nx.Graph(kept.keys())
    poses: dict[int, tuple[int, Array]] = {}
    components = sorted((sorted(c) for c in nx.connected_components(graph)), key=_by_size)
    for component, scans in enumerate(components):
        inside = {pair: edge for pair, edge in kept.items() if pair[0] in scans}
        solved = BACKENDS[peer.backend](scans, inside)
        poses.update({scan: (component, pose) for scan, pose in solved.items()})
    return {
        "scans": [_scan(name, poses.get(i)) for i, name in enumerate(names)],
        "pairs": [_pair(names, pair, edges.get(pair), pair in kept) for pair in pairs],
    }


def _edge(estimator: Estimator, source: View, target: View) -> Edge | None:
    coarse = estimator.match(source, target)
    return None if coarse is None else refine(source.cloud, target.cloud, *coarse)


def _by_size(scans: list[int]) -> tuple[int, int]:
    return -len(scans), scans[0]


def _scan(name: str, placement: tuple[int, Array] | None) -> Json:
    component, pose = placement or (None, None)
    return {
        "name": name,
        "placed": pose is not None,
        "component": component,
        "world_T_scan": None if pose is None else pose.tolist(),
    }


def _pair(names: Sequence[str], pair: tuple[int, int], edge: Edge | None, kept: bool) -> Json:
    candidates = []
    if edge is not None:
        pose = edge.target_T_source.tolist()
        candidates = [{"rank": 0, "target_T_source": pose, "score": edge.support}]
    source, target = (names[i] for i in pair)
    selected = 0 if kept else None
    return {"source": source, "target": target, "selected": selected, "candidates": candidates}
