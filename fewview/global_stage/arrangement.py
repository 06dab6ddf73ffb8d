"""What the candidates leave open, decided by all scans that a place puts together.

The search over candidates (`discrete`) settles most scans of most sets. Scans that stand with less
certainty than `SURE` are taken up again, each for itself; the sure ones of a component stay one
rigid node, unless what its scans see and foresee denies a link that holds it together: candidates
of surfaces that look alike agree with each other where all are wrong. From what the candidates have
settled and from seeded trees, nodes and components move to the best of their `places` until
nothing improves S' of that module. Then every node, and every block on one side of a weak link,
stands right with its share of the odds of all its places, "elsewhere" among them; a scan is right
relative to another when every block that separates the two is, as in `belief`.
"""

from __future__ import annotations

import itertools

import numpy as np
from scipy.sparse import csgraph, csr_array
from scipy.special import logsumexp

from fewview.geometry import se3
from fewview.global_stage.belief import CEILING, chances
from fewview.global_stage.blocks import tree_blocks
from fewview.global_stage.comparison import Answer, says_new
from fewview.global_stage.discrete import grown
from fewview.global_stage.model import TOLD_EVIDENCE, Problem
from fewview.global_stage.placement import State, agreement_now, gain_matrix
from fewview.global_stage.places import Places, Potentials, places
from fewview.types import Array, BoolArray, IntArray

SURE = 0.98
"""Scans that the candidates alone place with this probability are not asked about again."""

CONFIRMED = 2.0
"""Log odds of a link, by what its scans see and foresee, below which they deny it."""

TREES = 3
"""Random trees from which the search starts, beside what the candidates have settled: sets of five
scans need none, two rooms in one folder came out as one with a single tree."""

SWEEPS = 6
"""Times that all nodes and components may move, at most."""

RIGID = 1e6
"""Strength of the links inside a node: no weak link ever runs through it."""

SPEAKERS, STRONGEST = 6, 3
"""Pairs of scans asked how a block stands to a component, or a node to another, and how many by
their candidates."""

LOOK_M = 1.5
"""What a camera looks at is this far in front of it."""

TOLERANCE = 1e-6
"""Smallest improvement of the log odds that counts."""


class Arranging:
    """One problem with the nodes that the candidates alone have settled.

    Attributes:
        rigid: (n, n) scans that stay as they stand to each other.
        nodes: (k, n) the groups of such scans.
        within: (n,) probability that each scan stands right in its node; told ones do.

    Args:
        problem: the candidates.
        settled: the labelling that they agree on.
        probability: (n,) of each scan there.
        potentials: of pairs of scans.
    """

    def __init__(
        self, problem: Problem, settled: State, probability: Array, potentials: Potentials
    ) -> None:
        self.problem = problem
        self.potentials = potentials
        self.settled = settled
        self.rigid = self._undenied(_rigid(problem, settled, probability))
        self.nodes: BoolArray = np.unique(self.rigid, axis=0)
        self.asked = speakers(problem, settled, self.nodes)
        sure = (probability >= SURE) & (self.rigid.sum(axis=1) > 1)
        self.within: Array = np.where(sure, probability, 1.0)

    @property
    def open(self) -> bool:
        """Whether anything is left to decide."""
        return len(self.nodes) > 1

    def search(self, seed: int, count: int) -> list[Answer]:
        """The best ``count`` answers at most, best first, each saying something new."""
        found = [self._from_start(seed, start) for start in range(1 + TREES)]
        found.sort(key=lambda one: -one.score)
        found += self._neighbours(found[0])
        kept: list[Answer] = []
        for one in sorted(found, key=lambda one: -one.score):
            known = [other.state for other in kept]
            if len(kept) < count and says_new(self.problem, one.state, known):
                kept.append(one)
        return kept

    def judge(self, state: State) -> Array:
        """(n,) probability that each scan stands right in its component; 0 for scans alone."""
        blocks = self._blocks(state)
        doubt = np.array([_doubt(state, block, self._places(state, block)) for block in blocks])
        chance, _ = chances(state, blocks, doubt.reshape(-1), self.problem.fixed)
        return np.minimum(chance * self.within, CEILING)

    def drop_doubtful(self, state: State, min_probability: float) -> Array:
        """Set nodes apart, in place, that are not probable enough.

        The others keep what these say for them: to be doubted is not to be wrong. A node of several
        scans is a component of its own then.

        Returns:
            (n,) probabilities afterwards; 0 for scans alone.
        """
        probability = self.judge(state)
        for node in self.nodes:
            if probability[node].min() < min_probability:
                state.detach(node)
                alone = node.sum() == 1
                probability[node] = 0.0 if alone else np.minimum(self.within[node], CEILING)
        return probability

    def _undenied(self, rigid: BoolArray) -> BoolArray:
        """Nodes without the links that the scans on both sides deny."""
        bound = _bound(self.problem, self.settled)
        for side in tree_blocks(gain_matrix(self.problem, self.settled)):
            other = (self.settled.component == self.settled.component[side][0]) & ~side
            if np.any(rigid[side][:, other]) and not np.any(bound[side][:, other]):
                pairs = speakers(self.problem, self.settled, np.stack([side, other]))
                held = 0.5 * self.matrix(self.settled, pairs).sum() + self.potentials.join
                if held < CONFIRMED:
                    rigid = rigid & (side[:, None] == side)
        return rigid

    def _tree(self, rng: np.random.Generator) -> State:
        """A spanning forest of the nodes by strong candidates, at random."""
        state = State(self.settled.pose.copy(), np.argmax(self.rigid, axis=1))
        key = np.log(self.problem.evidence)
        grown(self.problem, state, key + rng.gumbel(size=len(key)))
        return state

    def _from_start(self, seed: int, start: int) -> Answer:
        """What the search finds from the settled answer, start 0, or from a tree."""
        rng = np.random.default_rng((seed, start))
        return self._polished(self._tree(rng) if start else self.settled.copy(), rng)

    def _polished(self, state: State, rng: np.random.Generator) -> Answer:
        """Move nodes and components, and when these rest, sides of weak links, until nothing
        improves."""
        for _ in range(SWEEPS):
            moved = [self._improve(state, node) for node in rng.permutation(self.nodes)]
            whole = state.component == np.unique(state.component)[:, None]
            moved += [self._improve(state, block) for block in whole]
            if not any(moved) and not any(self._improve(state, b) for b in self._blocks(state)):
                break
        return Answer(state, self._score(state))

    def _improve(self, state: State, block: BoolArray) -> bool:
        """Move a block to its best place, or apart, if that improves."""
        if block.all() or len(np.unique(state.component[block])) > 1:
            return False
        found = self._places(state, block)
        best = int(np.argmax(found.score)) if len(found.score) else -1
        gain = found.score[best] if best >= 0 else -np.inf
        if max(gain, 0.0) <= found.stay + TOLERANCE:
            return False
        if gain > 0.0:
            state.move(block, found.motion[best], int(found.component[best]))
        else:
            state.detach(block)
        return True

    def _neighbours(self, best: Answer) -> list[Answer]:
        """The best other place of every node of the best arrangement."""
        found = []
        for node in self.nodes:
            choice = self._places(best.state, node)
            if len(choice.score):
                k = int(np.argmax(choice.score))
                state = best.state.copy()
                state.move(node, choice.motion[k], int(choice.component[k]))
                gained = float(choice.score[k]) - choice.stay
                found.append(Answer(state, best.score + gained))
        return found

    def _places(self, state: State, block: BoolArray) -> Places:
        frames = np.unique(state.component[~block])
        rest = (state.component == frames[:, None]) & ~block
        heard = [speakers(self.problem, state, np.stack([block, others])) for others in rest]
        return places(self.problem, state, block, self.potentials, np.any(heard, axis=0))

    def _score(self, state: State) -> float:
        joins = len(self.nodes) - len(np.unique(state.component))
        return float(0.5 * self.matrix(state).sum() + joins * self.potentials.join)

    def matrix(self, state: State, asked: BoolArray | None = None) -> Array:
        """(n, n) symmetric potentials of the pairs that are asked, by default those between nodes,
        and stand together."""
        votes = gain_matrix(self.problem, state)
        asked = self.asked if asked is None else asked
        asked = (state.component[:, None] == state.component) & asked
        out = np.zeros_like(votes)
        for i, j in np.argwhere(np.triu(asked)).tolist():
            motion = se3.inverse(state.pose[j]) @ state.pose[i]
            found = self.potentials.potential(i, j, motion[None], votes[i, j : j + 1])
            out[i, j] = out[j, i] = found[0]
        return out

    def _blocks(self, state: State) -> BoolArray:
        """Sides of weak links, and single nodes; each split of a component comes once, as the side
        without its first scan."""
        together = state.component[:, None] == state.component
        strength = np.where(self.rigid, RIGID, np.logaddexp(0.0, self.matrix(state))) * together
        np.fill_diagonal(strength, 0.0)
        sides = np.concatenate([tree_blocks(strength), self.nodes])
        sides = sides[[not np.any(self.rigid[side] & ~side) for side in sides]]
        component = together[np.argmax(sides, axis=1)]
        first = component & (np.cumsum(component, axis=1) == 1)
        sides = np.where((sides & first).any(axis=1)[:, None], component & ~sides, sides)
        return np.unique(sides[sides.any(axis=1)], axis=0)


def speakers(problem: Problem, state: State, nodes: BoolArray) -> BoolArray:
    """(n, n) pairs of scans that are asked how any two of the nodes stand to each other.

    Of large nodes a few scans speak for all: the potential is fitted to a few, and what many say
    that show the same is said once. The pairs with the strongest candidates come first, then those
    of scans that look at different places; a veto is always heard.
    """
    votes = problem.strongest
    seen = se3.transform(state.pose, np.array([[0.0, 0.0, LOOK_M]]))[:, 0]
    order = np.full(problem.scans, SPEAKERS)
    for node in nodes:
        first = _spread(seen, np.flatnonzero(node), SPEAKERS)
        order[first] = np.arange(len(first))
    asked = np.zeros_like(votes, dtype=bool)
    for one, other in itertools.combinations(nodes, 2):
        i, j = np.nonzero(np.outer(one, other))
        strongest = np.argsort(-votes[i, j], kind="stable")[:STRONGEST]
        strongest = strongest[votes[i, j][strongest] > 0.0]
        different = np.argsort(order[i] + order[j], kind="stable")
        chosen = list(dict.fromkeys([*strongest.tolist(), *different.tolist()]))[:SPEAKERS]
        asked[i[chosen], j[chosen]] = True
    for source, target in problem.vetoed:
        asked[source, target] = not np.any(nodes[:, source] & nodes[:, target])
    return np.asarray(asked | asked.T)


def _spread(points: Array, members: IntArray, count: int) -> IntArray:
    """The first ``count`` members, each far from all before it; the first one stays."""
    chosen = [0]
    gap = np.linalg.norm(points[members] - points[members[0]], axis=1)
    for _ in range(min(count, len(members)) - 1):
        gap[chosen] = -1.0
        chosen.append(int(np.argmax(gap)))
        gap = np.minimum(gap, np.linalg.norm(points[members] - points[members[chosen[-1]]], axis=1))
    return np.asarray(members[chosen])


def _rigid(problem: Problem, settled: State, probability: Array) -> BoolArray:
    """(n, n) scans that stay as they stand to each other: sure ones, fixed ones, told pairs."""
    together = settled.component[:, None] == settled.component
    sure = (probability >= SURE) | problem.fixed
    return _connected((sure[:, None] & sure & together) | _bound(problem, settled))


def _bound(problem: Problem, settled: State) -> BoolArray:
    """(n, n) scans that the user has bound to each other."""
    linked = problem.fixed[:, None] & problem.fixed
    told = (problem.evidence >= TOLD_EVIDENCE) & (agreement_now(problem, settled) > 0.0)
    linked[problem.source[told], problem.target[told]] = True
    return _connected(linked)


def _connected(linked: BoolArray) -> BoolArray:
    _, node = csgraph.connected_components(csr_array(linked), directed=False)
    return np.asarray(node[:, None] == node)


def _doubt(state: State, block: BoolArray, found: Places) -> float:
    """log(1 + w), w the odds of all other places in the component and of none against this one."""
    rivals = found.score[found.component == state.component[block][0]]
    return float(np.logaddexp(0.0, logsumexp(np.append(rivals, 0.0)) - found.stay))
