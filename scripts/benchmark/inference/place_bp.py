"""Belief propagation over whole places: the labels and scores of `labels` in one pass."""

from __future__ import annotations

import numpy as np

from benchmark.inference import labels
from benchmark.inference.finish import separate
from benchmark.inference.labels import Network
from benchmark.inference.messages import best_labels
from fewview.global_stage.model import Problem
from fewview.global_stage.placement import State
from fewview.types import IntArray


def place_bp(problem: Problem, seed: int) -> State:
    """Max-product belief propagation, rotation and translation together."""
    return separate(problem, labels.solve(problem, seed, _one_pass))


def _one_pass(network: Network) -> IntArray:
    unary = np.where(network.allowed, network.unary, -np.inf)
    return best_labels(unary, network.pair, network.gain, network.score)
