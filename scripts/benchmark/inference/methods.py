"""The methods that are compared; all maximise `placement.objective`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmark.inference import cost_network
from benchmark.inference.camera_bp import camera_bp
from benchmark.inference.cost_network import RESTARTS, cost_network_around
from benchmark.inference.edge_bp import edge_bp
from benchmark.inference.finish import separate
from benchmark.inference.place_bp import place_bp
from fewview.global_stage import discrete
from fewview.global_stage.model import Problem
from fewview.global_stage.placement import State


@dataclass(frozen=True)
class Method:
    """A way to find a labelling.

    Attributes:
        label: for tables.
        solve: problem and seed to a labelling.
    """

    label: str
    solve: Callable[[Problem, int], State]


def tree(problem: Problem, seed: int) -> State:
    """The maximum spanning tree of the evidence, its weak links cut; the seed plays no part."""
    return separate(problem, discrete.spanning_tree(problem, np.log(problem.evidence)))


def search(problem: Problem, seed: int) -> State:
    """What `global_stage.solve` ships."""
    return discrete.search(problem, RESTARTS, seed)[0]


def methods() -> dict[str, Method]:
    """All of them; those of toulbar2 only where it is installed."""
    known = {
        "tree": Method("Maximum spanning tree", tree),
        "camera_bp": Method("BP over cameras, rotations first (Crandall et al.)", camera_bp),
        "place_bp": Method("BP over cameras, whole poses", place_bp),
        "edge_bp": Method("BP over edges, triangles (Zach et al.)", edge_bp),
        "ours": Method("Ours: trees and moves", search),
    }
    if cost_network.available():
        known["toulbar2"] = Method("toulbar2, same labels as BP", cost_network.cost_network)
        known["toulbar2_ours"] = Method("toulbar2, our places among them", cost_network_around)
    return known
