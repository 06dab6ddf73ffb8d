"""Max-product belief propagation on a graph of pairs, all messages at once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fewview.types import Array, IntArray

ROUNDS, DAMPING = 60, 0.5


def best_labels(
    unary: Array, pair: IntArray, gain: Array, score: Callable[[IntArray], float]
) -> IntArray:
    """The best of the labellings that the beliefs name, round by round.

    Args:
        unary: (n, l), minus infinity where a label is not allowed.
        pair: (e, 2) nodes.
        gain: (e, l, l) of the pair's labels, first node first.
        score: of (n,) labels, to choose between rounds.

    Returns:
        (n,) labels.
    """
    sender = np.concatenate([pair[:, 0], pair[:, 1]])
    receiver = np.concatenate([pair[:, 1], pair[:, 0]])
    reverse = np.roll(np.arange(len(sender)), len(pair))
    table = np.concatenate([gain, np.swapaxes(gain, 1, 2)])
    message = np.zeros((len(sender), unary.shape[1]))
    best: IntArray = np.argmax(unary, axis=1)
    best_score = -np.inf
    for _ in range(ROUNDS):
        belief = unary.copy()
        np.add.at(belief, receiver, message)
        label: IntArray = np.argmax(belief, axis=1)
        if (now := score(label)) > best_score:
            best, best_score = label, now
        cavity = belief[sender] - message[reverse]
        sent = np.max(cavity[:, :, None] + table, axis=1)
        sent -= sent.max(axis=1, keepdims=True)
        message = DAMPING * message + (1.0 - DAMPING) * sent
    return best
