"""Pose-graph back-ends: they chain what is right and resist an edge that is wrong."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np
import pytest

from benchmark.backends.pose_graphs import Edges, gnc, robust_rec
from benchmark.methods.interface import Candidate
from fewview.geometry import se3
from fewview.types import Array

SCANS = [3, 5, 6, 8, 9]
WRONG = (3, 8)


def graph() -> tuple[dict[int, Array], dict[tuple[int, int], Candidate]]:
    rng = np.random.default_rng(0)
    truth = {scan: se3.exp(rng.normal(scale=0.6, size=6)) for scan in SCANS}
    edges = {}
    for source, target in combinations(SCANS, 2):
        pose = se3.inverse(truth[target]) @ truth[source] @ se3.exp(rng.normal(scale=1e-3, size=6))
        if (source, target) == WRONG:
            pose = pose @ se3.exp(np.array([0.0, 1.2, 0.0, 0.8, 0.0, 0.3]))
        overlap = 0.2 if (source, target) == WRONG else float(rng.uniform(0.3, 0.8))
        edges[source, target] = Candidate(pose, 200.0, None, overlap, 1000.0 * np.eye(6))
    return truth, edges


@pytest.mark.parametrize("solve", [robust_rec, gnc])
def test_a_wrong_edge_does_not_bend_the_graph(
    solve: Callable[[list[int], Edges], dict[int, Array]],
) -> None:
    truth, edges = graph()
    found = solve(SCANS, edges)
    assert sorted(found) == SCANS
    for scan in SCANS:
        expected = se3.inverse(truth[SCANS[0]]) @ truth[scan]
        rotation, shift = se3.distance(expected, se3.inverse(found[SCANS[0]]) @ found[scan])
        assert float(rotation) < 0.01
        assert float(shift) < 0.01
