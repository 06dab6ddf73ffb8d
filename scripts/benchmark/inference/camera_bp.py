"""Belief propagation over camera poses, rotations first (Crandall et al., PAMI 2013).

The labels of a scan are places that spanning trees propose. The first pass chooses a rotation for
every scan, by candidates whose rotation agrees; the second a place of that rotation, or none.
"""

from __future__ import annotations

import numpy as np

from benchmark.inference import labels
from benchmark.inference.finish import separate
from benchmark.inference.labels import Network
from benchmark.inference.messages import best_labels
from fewview.global_stage.model import Problem
from fewview.global_stage.placement import KERNEL_RADIUS, State, pair_gains
from fewview.types import Array, BoolArray, IntArray


def camera_bp(problem: Problem, seed: int) -> State:
    """Rotations, then translations, by max-product belief propagation."""
    return separate(problem, labels.solve(problem, seed, _two_passes))


def _two_passes(network: Network) -> IntArray:
    barred = np.where(network.allowed, 0.0, -np.inf)
    barred[:, 0] = np.where(network.allowed[:, 1:].any(axis=1), -np.inf, 0.0)
    gain = _rotation_gains(network)

    def rotation_score(label: IntArray) -> float:
        first, second = network.pair.T
        return float(gain[np.arange(len(gain)), label[first], label[second]].sum())

    chosen = best_labels(barred, network.pair, gain, rotation_score)
    unary = np.where(_alike(network, chosen) & network.allowed, network.unary, -np.inf)
    return best_labels(unary, network.pair, network.gain, network.score)


def _rotation_gains(network: Network) -> Array:
    """(e, l, l) log(1 + sum r a) with a the agreement of rotations alone."""
    problem, turn = network.problem, network.place[..., :3, :3]
    size = turn.shape[1]
    gain = np.zeros_like(network.gain)
    first = np.flatnonzero(np.diff(problem.pair, prepend=-1))
    for k, candidates in enumerate(np.split(np.arange(len(problem.pair)), first[1:])):
        source, target = network.pair[k]
        error = np.swapaxes(turn[target, None], -1, -2) @ turn[source, :, None]
        trace = np.einsum("abij,cij->abc", error, problem.motion[candidates, :3, :3])
        agree = _agreement(problem, trace).reshape(size * size, -1)
        gain[k] = pair_gains(problem, candidates, agree).reshape(size, size)
    gain[:, 0] = gain[:, :, 0] = 0.0
    return gain


def _alike(network: Network, chosen: IntArray) -> BoolArray:
    """(n, l) labels with the chosen rotation, and "elsewhere"."""
    turn = network.place[..., :3, :3]
    asked = turn[np.arange(len(turn)), chosen]
    trace = np.einsum("nlij,nij->nl", turn, asked)
    alike = _agreement(network.problem, trace) > 0.0
    alike[:, 0] = True
    return np.asarray(alike)


def _agreement(problem: Problem, trace: Array) -> Array:
    ratio2 = (3.0 - trace) / problem.max_chord2
    return np.asarray(np.square(np.maximum(1.0 - ratio2 / KERNEL_RADIUS**2, 0.0)))
