"""Exact or, out of time, the best so far: toulbar2 on the cost function network of `labels`."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec

import numpy as np

from benchmark.inference import labels
from benchmark.inference.finish import separate
from benchmark.inference.labels import Network
from fewview.global_stage import discrete
from fewview.global_stage.model import Problem
from fewview.global_stage.placement import State
from fewview.types import IntArray

PACKAGE = "pytoulbar2"
DECIMALS = 4
TIME_LIMIT_S = 5
"""Of each component's network."""
RESTARTS = 16


def available() -> bool:
    """Whether the solver is installed: ``pip install pytoulbar2``."""
    return find_spec(PACKAGE) is not None


def cost_network(problem: Problem, seed: int) -> State:
    """The optimum over the places that spanning trees propose."""
    return separate(problem, labels.solve(problem, seed, _optimum))


def cost_network_around(problem: Problem, seed: int) -> State:
    """The optimum over these places and those of our search: what the search left behind."""
    hints = tuple(discrete.search(problem, RESTARTS, seed))
    return separate(problem, labels.solve(problem, seed, _optimum, hints))


def _optimum(network: Network) -> IntArray:
    choices = [np.flatnonzero(allowed) for allowed in network.allowed]
    upper = float(-network.unary.min(axis=1).sum() + 1.0)
    solver = import_module(PACKAGE).CFN(upper, DECIMALS)
    for i, choice in enumerate(choices):
        solver.AddVariable(f"scan{i}", [f"p{c}" for c in choice.tolist()])
        solver.AddFunction([i], (-network.unary[i, choice]).tolist())
    for (source, target), gain in zip(network.pair.tolist(), network.gain, strict=True):
        costs = -gain[np.ix_(choices[source], choices[target])]
        solver.AddFunction([source, target], costs.ravel().tolist())
    solution = solver.Solve(timeLimit=TIME_LIMIT_S)
    picked = [0] * len(choices) if solution is None else solution[0]
    return np.array([choice[k] for choice, k in zip(choices, picked, strict=True)])
