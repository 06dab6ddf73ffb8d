"""Belief propagation over edges: which candidate of a pair is right, if any, by loops of three.

After Zach, Klopschitz and Pollefeys (CVPR 2010): the labels of a pair are its candidates, of prior
p_k, and none, 1 - P. Three candidates around a triangle speak for each other, by -log v, where
they close, and against each other, as much, where they do not. The triangles of a complete graph
count 3 / n each, so that together they weigh what its independent loops do. Poses are chained along
the tree of the surest edges.
"""

from __future__ import annotations

import itertools

import numpy as np

from benchmark.inference.finish import separate
from fewview.global_stage.discrete import spanning_tree
from fewview.global_stage.model import Problem
from fewview.global_stage.placement import State, likeness
from fewview.types import Array, IntArray

ROUNDS, DAMPING = 40, 0.5


def edge_bp(problem: Problem, seed: int) -> State:
    """Max-product belief propagation over edge labels; the seed plays no part."""
    label = _labels(problem)
    unary = _priors(problem, label)
    triangle = _triangles(problem)
    belief = _beliefs(unary, triangle, _closing(problem, label, triangle))
    margin = belief[:, 1:] - belief[:, :1]
    key = np.full(len(problem.source), -np.inf)
    listed = label >= 0
    key[label[listed]] = margin[listed]
    return separate(problem, spanning_tree(problem, key))


def _labels(problem: Problem) -> IntArray:
    """(e, k) candidates of every pair, -1 where it has fewer than k."""
    _, edge = np.unique(problem.pair, return_inverse=True)
    first = np.flatnonzero(np.diff(problem.pair, prepend=-1))
    column = np.arange(len(edge)) - first[edge]
    label = np.full((len(first), int(column.max(initial=-1)) + 1), -1, dtype=np.int64)
    label[edge, column] = np.arange(len(edge))
    return label


def _priors(problem: Problem, label: IntArray) -> Array:
    """(e, 1 + k) log probabilities, none first."""
    probability = np.where(label >= 0, problem.probability[label], 0.0)
    none = 1.0 - probability.sum(axis=1, keepdims=True)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(np.concatenate([none, probability], axis=1)))


def _triangles(problem: Problem) -> IntArray:
    """(t, 3) edges i-j, j-k, i-k of every triple of scans whose pairs all have candidates."""
    first = np.flatnonzero(np.diff(problem.pair, prepend=-1))
    ends = np.sort(np.stack([problem.source[first], problem.target[first]], axis=1), axis=1)
    edge = {(int(a), int(b)): e for e, (a, b) in enumerate(ends)}
    found = [
        (edge[i, j], edge[j, k], edge[i, k])
        for i, j, k in itertools.combinations(range(problem.scans), 3)
        if (i, j) in edge and (j, k) in edge and (i, k) in edge
    ]
    return np.array(found, dtype=np.int64).reshape(-1, 3)


def _closing(problem: Problem, label: IntArray, triangle: IntArray) -> Array:
    """(t, 1 + k, 1 + k, 1 + k) what the labels of three edges say of each other."""
    motion = problem.motion[label]
    turned = (problem.source < problem.target)[label]
    later_T_earlier = np.where(turned[..., None, None], motion, problem.inverse_motion[label])
    first, second, direct = (later_T_earlier[edges] for edges in triangle.T)
    around = second[:, None, :] @ first[:, :, None]
    close = likeness(problem, around[:, :, :, None], direct[:, None, None])
    out = np.zeros((len(triangle), *[1 + label.shape[1]] * 3))
    out[:, 1:, 1:, 1:] = (2.0 * close - 1.0) * problem.prior_cost * 3.0 / problem.scans
    return out


def _beliefs(unary: Array, triangle: IntArray, table: Array) -> Array:
    """(e, 1 + k) max-marginals after some rounds."""
    message = np.zeros((len(triangle), 3, unary.shape[1]))
    belief = unary.copy()
    for _ in range(ROUNDS):
        cavity = belief[triangle] - message
        cavity = np.nan_to_num(cavity, neginf=-1e9)
        one, two, three = cavity[:, 0], cavity[:, 1], cavity[:, 2]
        total = table + one[:, :, None, None] + two[:, None, :, None] + three[:, None, None]
        sent = np.stack([total.max((2, 3)), total.max((1, 3)), total.max((1, 2))], axis=1) - cavity
        sent -= sent.max(axis=2, keepdims=True)
        message = DAMPING * message + (1.0 - DAMPING) * sent
        belief = unary.copy()
        np.add.at(belief, triangle, message)
    return belief
