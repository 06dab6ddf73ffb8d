"""What the user knows, and what it does to the candidates of pairs.

A told candidate takes all the probability of its pair. A vetoed one loses its own: of the
exclusive outcomes "candidate k is right" and "none is", the others share it by Bayes' rule,
p_k / (1 - vetoed).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from fewview.errors import PriorsError
from fewview.geometry import se3
from fewview.types import (
    Array,
    CandidateOrigin,
    Evidence,
    GlobalSolution,
    PairResult,
    PairStatus,
    PoseCandidate,
    Representation,
)

GIVEN_SIGMA = 1e-3
"""Standard deviation (rad, m) of a given relative pose: the digits that a user would write."""


@dataclass(frozen=True)
class PairPrior:
    """What is known of a pair; ranks are those of its candidates.

    Attributes:
        target_T_source: (4, 4) the relative pose; settles the pair.
        pin: rank of the candidate that is right; settles the pair.
        veto: ranks of candidates that are wrong, or ``"all"``.
    """

    target_T_source: Array | None = None
    pin: int | None = None
    veto: frozenset[int] | Literal["all"] = frozenset()

    @property
    def ranks(self) -> frozenset[int]:
        """Every rank that is spoken of."""
        vetoed = frozenset() if self.veto == "all" else self.veto
        return vetoed if self.pin is None else vetoed | {self.pin}


@dataclass(frozen=True)
class Priors:
    """What is known of a set of scans; scans are indices into its list.

    Attributes:
        names: of all scans, for messages.
        up: scan -> (3,) unit up direction in its camera axes.
        poses: scan -> (4, 4) world_T_scan, as given.
        pairs: (source, target) with source < target -> what is known of the pair.
    """

    names: tuple[str, ...] = ()
    up: Mapping[int, Array] = field(default_factory=dict)
    poses: Mapping[int, Array] = field(default_factory=dict)
    pairs: Mapping[tuple[int, int], PairPrior] = field(default_factory=dict)

    def of_pair(self, source: int, target: int) -> PairPrior | None:
        """What is known of a pair, by its entry or by the fixed poses of both scans."""
        if source in self.poses and target in self.poses:
            world_T = se3.rigid(np.stack([self.poses[source], self.poses[target]]))
            return PairPrior(se3.inverse(world_T[1]) @ world_T[0])
        return self.pairs.get((source, target))

    def constrain(self, pair: PairResult) -> PairResult:
        """The pair with what is known of it put in.

        Raises:
            PriorsError: the pair has no candidate of a rank that is spoken of.
        """
        prior = self.of_pair(pair.source, pair.target)
        if prior is None:
            return pair
        if missing := prior.ranks - {c.rank for c in pair.candidates}:
            raise PriorsError(
                f"priors: {self._title(pair)} has {len(pair.candidates)} candidates in this run, "
                f"none of rank {min(missing)}; ranks hold for the settings and scans of the report "
                "that they were read from"
            )
        return constrained(pair, prior)

    def check(self, pairs: Iterable[PairResult], solution: GlobalSolution) -> None:
        """Make sure that the answer holds all that was told.

        Raises:
            PriorsError: something told was given up, as it contradicts the rest.
        """
        for pair in pairs:
            told = next((c.rank for c in pair.candidates if c.told), None)
            if told is not None and solution.selected.get((pair.source, pair.target)) != told:
                raise PriorsError(
                    f"priors: what is told of {self._title(pair)} contradicts what is told of "
                    "other pairs and poses; correct one of them"
                )

    def _title(self, pair: PairResult) -> str:
        return f"{self.names[pair.source]} - {self.names[pair.target]}"


def constrained(pair: PairResult, prior: PairPrior) -> PairResult:
    """A pair with what is known of it put into its candidates' probabilities."""
    if prior.target_T_source is not None:
        return _settled(pair, _given(len(pair.candidates), prior.target_T_source))
    if prior.pin is not None:
        return _settled(pair, next(c for c in pair.candidates if c.rank == prior.pin))
    ranks = frozenset(c.rank for c in pair.candidates)
    vetoed = ranks if prior.veto == "all" else prior.veto
    left = replace(pair, candidates=_without(pair.candidates, vetoed))
    if not ranks or vetoed != ranks:
        return left
    reason = "every candidate was vetoed"
    return replace(left, status=PairStatus.NOTHING_BELIEVABLE, reason=reason)


def _settled(pair: PairResult, right: PoseCandidate) -> PairResult:
    """The pair whose candidate of that rank, found or new, is right and all others are wrong."""
    others = {c.rank: replace(c, probability=0.0) for c in pair.candidates}
    candidates = others | {right.rank: replace(right, probability=1.0, told=True)}
    return replace(pair, status=PairStatus.OK, candidates=tuple(candidates.values()), reason=None)


def _given(rank: int, target_T_source: Array) -> PoseCandidate:
    """A relative pose from the user; nothing was measured of it."""
    evidence = Evidence(0.0, 0.0, 0.0, dict.fromkeys(Representation, 0))
    covariance = GIVEN_SIGMA**2 * np.eye(6)
    origin = CandidateOrigin.GIVEN
    return PoseCandidate(rank, target_T_source, origin, 0.0, 1.0, evidence, covariance)


def _without(
    candidates: Sequence[PoseCandidate], vetoed: frozenset[int]
) -> tuple[PoseCandidate, ...]:
    """Candidates of which some are known to be wrong."""
    kept = {c.rank: c.probability for c in candidates if c.rank not in vetoed}
    wrong = sum(c.probability for c in candidates if c.rank in vetoed)
    remaining = max(1.0 - wrong, sum(kept.values()), np.finfo(np.float64).tiny)
    return tuple(
        replace(c, probability=kept.get(c.rank, 0.0) / remaining, vetoed=c.rank in vetoed)
        for c in candidates
    )
