"""What methods that cannot speak of components are given afterwards: a greedy separation."""

from __future__ import annotations

import numpy as np

from fewview.global_stage.blocks import pieces, tree_blocks
from fewview.global_stage.model import Problem
from fewview.global_stage.placement import State, gain_matrix


def separate(problem: Problem, state: State) -> State:
    """Cut the weakest link between two blocks, in place, while that saves more than it costs."""
    while True:
        gains = gain_matrix(problem, state)
        _, state.component[:] = pieces(gains)
        blocks = tree_blocks(gains)
        cuts = ((blocks @ gains) * ~blocks).sum(axis=1)
        if not len(cuts) or cuts.min() >= problem.join_cost:
            return state
        state.detach(blocks[int(np.argmin(cuts))])
