"""How probable it is that a scan stands right in its component.

For every block of scans on one side of a weak link, its other places are weighed against the
present one: w = sum exp(S_other - S_now), "in a frame of its own" included. The block stands right
with probability 1 / (1 + w), and a scan stands right relative to another when every block that
separates the two does:

    P(i right relative to j) = product over blocks that hold one of i, j of 1 / (1 + w).

Places in other components are no rivals: that the block belongs there too does not make it wrong
here. A block that comes loose may also fall apart, which matters in loops of weak links (the terms
of `_log_dissolved`: what the two parts gain by it over what the whole does). Links that repeat one
another count once (`novelty`). The product is exact for trees of links: a leaf carries the doubt of
every link on its way to the core. The core of a component is the scan relative to which most scans
are expected to be right, among those with a fixed pose where there are any.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from fewview.global_stage.blocks import pieces, tree_blocks
from fewview.global_stage.model import Problem
from fewview.global_stage.novelty import novel_scores, shared_views
from fewview.global_stage.placement import State, gain_matrix, options
from fewview.types import Array, BoolArray

CEILING = 0.999
"""No scan is reported surer than this: some errors are outside the model."""


@dataclass(frozen=True)
class Belief:
    """What is believed of a labelling.

    Attributes:
        probability: (n,) that each scan stands right relative to the core of its component; the
            core carries that of the scan it shares most with; 0 for scans alone.
        blocks: (k, n) blocks that could be wrong together, none of which holds a core.
        doubt: (k,) log(1 + w) of each block.
    """

    probability: Array
    blocks: BoolArray
    doubt: Array


def judge(problem: Problem, state: State) -> Belief:
    """Estimate the probability of every scan's place."""
    gains = gain_matrix(problem, state)
    blocks = _suspects(gains, state)
    shared = shared_views(problem, state)
    doubt = np.array([_doubt(problem, state, gains, shared, block) for block in blocks])
    probability, cores = chances(state, blocks, doubt, problem.fixed)
    for core in cores:
        turned = blocks[:, core]
        blocks[turned] = (state.component == state.component[core]) & ~blocks[turned]
    return Belief(np.minimum(probability, CEILING), blocks, doubt)


def chances(
    state: State, blocks: BoolArray, doubt: Array, fixed: BoolArray
) -> tuple[Array, list[int]]:
    """The module's product of doubts.

    Args:
        state: the labelling.
        blocks: (k, n) that could be wrong together; doubt: (k,) log(1 + w) of each.
        fixed: (n,) scans that are the core of their component before all others.

    Returns:
        (n,) probability that each scan stands right relative to the core of its component, 0 for
        scans alone; the cores.
    """
    weighted = blocks.T * doubt
    agree = np.exp(-(weighted @ ~blocks + (weighted @ ~blocks).T))
    probability, cores = np.zeros(len(fixed)), []
    for label in np.unique(state.component):
        members = np.flatnonzero(state.component == label)
        if len(members) > 1:
            inside = agree[np.ix_(members, members)]
            core = int(np.argmax(inside.sum(axis=1) + len(members) * fixed[members]))
            probability[members] = inside[core]
            probability[members[core]] = np.max(np.delete(inside[core], core))
            cores.append(int(members[core]))
    return probability, cores


def drop_doubtful(problem: Problem, state: State, min_probability: float) -> Belief:
    """Cut blocks off, in place, until every scan of a component is probable enough.

    A block that is cut off keeps its own frame: it may be a component of its own.
    """
    belief = judge(problem, state)
    while np.any(low := (belief.probability < min_probability) & (belief.probability > 0.0)):
        within = ~np.any(belief.blocks & ~low, axis=1)
        order = np.lexsort((belief.doubt, belief.blocks.sum(axis=1), within))
        state.detach(belief.blocks[order[-1]])
        _, state.component[:] = pieces(gain_matrix(problem, state))
        belief = judge(problem, state)
    return belief


def _suspects(gains: Array, state: State) -> BoolArray:
    """Sides of the spanning forest's links, and single scans that no other scan hangs on.

    Each split of a component comes once, as the side without its first scan.
    """
    rows = list(tree_blocks(gains))
    for label in np.unique(state.component):
        members = np.flatnonzero(state.component == label)
        for scan in members if len(members) > 1 else []:
            others = members[members != scan]
            if pieces(gains[np.ix_(others, others)])[0] == 1:
                side = others if scan == members[0] else [scan]
                rows.append(np.isin(np.arange(len(gains)), side))
    return np.unique(np.reshape(rows, (-1, len(gains))).astype(bool), axis=0)


def _doubt(problem: Problem, state: State, gains: Array, shared: Array, block: BoolArray) -> float:
    """log(1 + w) of the module's formula."""
    choice = options(problem, state, block)
    stay, *_ = score = novel_scores(problem, choice, shared)
    home = state.component[block][0]
    rest = (state.component == home) & ~block
    accept = problem.join_cost - problem.prior_cost
    apart = (
        _log_dissolved(problem, gains, block)
        + _log_dissolved(problem, gains, rest)
        - _log_dissolved(problem, gains, block | rest)
        + np.logaddexp(0.0, problem.prior_cost - gains[np.ix_(block, rest)].sum())
    )
    rival = (choice.component == home) & ~choice.same & choice.best
    others = logsumexp(np.append(score[1:][rival], apart - accept))
    return float(np.logaddexp(0.0, others - stay))


def _log_dissolved(problem: Problem, gains: Array, part: BoolArray) -> float:
    """Log weight of a connected ``part`` in every state of its links, relative to its present."""
    inside = gains[np.ix_(part, part)]
    blocks = tree_blocks(inside).astype(np.float64)
    cuts = ((blocks @ inside) * (1.0 - blocks)).sum(axis=1)
    return float(np.logaddexp(0.0, problem.prior_cost - cuts).sum())
