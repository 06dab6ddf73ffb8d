"""Which K candidates of a pair are kept: the most probable ones, and every way it may be turned.

Where no candidate can be told to be right, five shifts of one rotation say less than one of each.
A candidate's worth is the probability that it is right, and a share of the probability that its
rotation is, unless one that is already kept has about the same rotation.
"""

from __future__ import annotations

import numpy as np

from fewview.geometry import se3
from fewview.types import Array, IntArray

TURN_WORTH = 0.3
"""What the right rotation alone is worth, against the right pose; chosen on validation rooms."""

SAME_TURN_RAD = 0.25 * np.pi
"""Rotations closer than this count as the same."""


def chosen(probability: Array, target_T_source: Array, turn_chance: Array, count: int) -> IntArray:
    """Indices of at most ``count`` candidates, the most worthy first.

    Args:
        probability: (K,) that each is right; what is missing to one is that none is.
        target_T_source: (K, 4, 4).
        turn_chance: (K,) probability of each candidate's rotation when none of them is right.
        count: how many to keep.
    """
    angle, _ = se3.distance(target_T_source[:, None], target_T_source[None])
    alike = angle < SAME_TURN_RAD
    turn = alike @ probability + (1.0 - probability.sum()) * turn_chance
    kept: list[int] = []
    for _ in range(min(count, len(probability))):
        new = ~alike[:, kept].any(axis=1)
        worth = probability + TURN_WORTH * new * turn
        worth[kept] = -np.inf
        kept.append(int(np.argmax(worth)))
    return np.array(kept, dtype=np.int64)
