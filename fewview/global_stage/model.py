"""What the discrete stage maximises: the posterior of the scans' poses given all candidates.

The relative pose T of a pair has, under its candidates k of probabilities p_k, a density relative
to the uniform one of

    m(T) = (1 - P) + sum_k p_k a_k(T) / v,      P = sum_k p_k,

with a_k the agreement (1 at the candidate, 0 well outside the tolerance) and v the chance that a
wrong candidate agrees. With a uniform prior, poses discretised to cells of size v, and "anywhere
else" as the state of scans in different components, the log posterior of a labelling relative to
"nothing is joined" is

    S = sum over pairs within a component of log(1 + sum_k r_k a_k(T)) - sum over components of
        (scans - 1) * J,            r_k = p_k / ((1 - P) v),   J = -log v + logit(p_min).

A single candidate joins two scans with S = log(p / (1 - P)) - logit(p_min): the posterior odds
against "elsewhere", measured from the least probability p_min that is accepted. Every further
candidate that agrees adds log r, far above zero even for a weak one: loops decide where no pair
can be trusted alone. Manhattan candidates have a larger v of their own: wrong ones often agree, as
they choose among the same four yaws and fit the same walls. v and the ceiling on P bound what a
single pair can claim. This is the discrete stage of Crandall et al. (PAMI 2013) with whole
candidates in place of separate rotation and translation terms.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from fewview.config import GlobalConfig
from fewview.geometry import se3
from fewview.types import Array, BoolArray, CandidateOrigin, IntArray, PairResult

MAX_PAIR_PROBABILITY = 0.99
"""No pair is surer than this, whatever its candidates add up to."""

TOLD_EVIDENCE = 1e100
"""r_k of a candidate that the user says is right: no number of found ones outweighs it."""


@dataclass(frozen=True)
class Problem:
    """All candidates that can matter, as flat arrays of length m sorted by pair.

    Attributes:
        scans: number of scans n.
        fixed: (n,) scans whose pose the user fixed.
        source, target: (m,) scan indices.
        pair: (m,) index into the list of pairs.
        rank: (m,) rank of the candidate within its pair.
        motion: (m, 4, 4) target_T_source.
        probability: (m,) calibrated, clipped.
        evidence: (m,) r_k of the module's formula.
        overlap: (m,) share of the smaller surface that the candidate lays on the other.
        prior_cost: -log v.
        join_cost: J of the module's formula.
        max_chord2: squared chord 2 (1 - cos) of the rotation tolerance.
        max_distance2: squared translation tolerance, square metres.
        vetoed: (source, target), the smaller first -> (k, 4, 4) target_T_source that the user
            says are wrong.
    """

    scans: int
    fixed: BoolArray
    source: IntArray
    target: IntArray
    pair: IntArray
    rank: IntArray
    motion: Array
    probability: Array
    evidence: Array
    overlap: Array
    prior_cost: float
    join_cost: float
    max_chord2: float
    max_distance2: float
    vetoed: Mapping[tuple[int, int], Array] = field(default_factory=dict)

    @cached_property
    def inverse_motion(self) -> Array:
        """(m, 4, 4) source_T_target."""
        return se3.inverse(self.motion)

    @cached_property
    def strongest(self) -> Array:
        """(n, n) symmetric: evidence of the strongest candidate of each pair of scans, or 0."""
        out = np.zeros((self.scans, self.scans))
        np.maximum.at(out, (self.source, self.target), self.evidence)
        return np.maximum(out, out.T)


def build(
    scans: int, pairs: Sequence[PairResult], config: GlobalConfig, fixed: Collection[int] = ()
) -> Problem:
    """Flatten the pairs' candidates; those less probable than chance agreement are left out."""
    rows = [
        (pair.source, pair.target, index, candidate.rank, candidate)
        for index, pair in enumerate(pairs)
        for candidate in pair.candidates
    ]
    probability = np.array([max(row[4].probability, 0.0) for row in rows], dtype=np.float64)
    index = np.array([row[:4] for row in rows], dtype=np.int64).reshape(-1, 4)
    total = np.bincount(index[:, 2], weights=probability, minlength=len(pairs))
    shrink = np.minimum(1.0, MAX_PAIR_PROBABILITY / np.maximum(total, 1e-12))
    probability = probability * shrink[index[:, 2]]
    elsewhere = 1.0 - np.minimum(total, MAX_PAIR_PROBABILITY)
    levelled = np.array([row[4].origin is not CandidateOrigin.SPECTRAL for row in rows], dtype=bool)
    chance = np.where(levelled, config.levelled_chance_agreement, config.chance_agreement)
    evidence = probability / (elsewhere[index[:, 2]] * chance)
    evidence[np.array([row[4].told for row in rows], dtype=bool)] = TOLD_EVIDENCE
    keep = np.flatnonzero(evidence > 1.0)
    kept = [rows[i][4] for i in keep]
    motions = [candidate.target_T_source for candidate in kept]
    overlap = [candidate.evidence.overlap for candidate in kept]
    accept = math.log(config.min_probability) - math.log1p(-config.min_probability)
    return Problem(
        scans=scans,
        fixed=np.isin(np.arange(scans), list(fixed)),
        source=index[keep, 0],
        target=index[keep, 1],
        pair=index[keep, 2],
        rank=index[keep, 3],
        motion=np.array(motions, dtype=np.float64).reshape(-1, 4, 4),
        probability=probability[keep],
        evidence=evidence[keep],
        overlap=np.array(overlap, dtype=np.float64),
        prior_cost=-math.log(config.chance_agreement),
        join_cost=accept - math.log(config.chance_agreement),
        max_chord2=float(2.0 - 2.0 * np.cos(np.radians(config.max_angle_deg))),
        max_distance2=config.max_distance_m**2,
        vetoed=_vetoed(pairs),
    )


def _vetoed(pairs: Sequence[PairResult]) -> dict[tuple[int, int], Array]:
    """`Problem.vetoed`."""
    out: dict[tuple[int, int], Array] = {}
    for pair in pairs:
        if wrong := [c.target_T_source for c in pair.candidates if c.vetoed]:
            forward = pair.source < pair.target
            ends = (pair.source, pair.target) if forward else (pair.target, pair.source)
            out[ends] = np.stack(wrong) if forward else se3.inverse(np.stack(wrong))
    return out
