"""How well two scans stand together under any relative pose, whoever proposed it.

The potential of a pair of scans is a logit of what they say of each other where they stand: what
each sees in the other's free space and on its surfaces, where one predicts what the other saw, how
well their completed rooms lie over each other, and the votes of their own candidates. The sum over
all pairs that a place of a scan creates is the log odds of that place (`global_stage.places`). The
coefficients are fitted by pseudo-likelihood: one scan among others that stand right, over all
places that anything proposes for it (scripts/fit_potential.py).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib import resources

import numpy as np

from fewview.alignment import Alignment, Embedded, embed, joint_drawing
from fewview.geometry import se3
from fewview.matching.heights import lift, lifted
from fewview.matching.prepared import PreparedScan, aligned
from fewview.probability import ProbabilityModel, from_dict, number
from fewview.refinement.evidence import (
    gravity_disagreement,
    surface_agreement,
    visible_agreement,
    yaw_disagreement,
)
from fewview.refinement.room_evidence import room_evidence
from fewview.types import Array, CandidateOrigin, Evidence, PoseCandidate, Representation

VOTES = "votes"
"""The quantity that is no property of the pose: what the pair's candidates say of it."""

PROPOSED = 6
"""Places that the aligner proposes for a group of scans over another."""

MOST_DRAWN = 5
"""Scans of both groups up to which drawings count: they were weighed on sets of five, and of ten
they say too much."""

LEAST = -9.0
"""Log probability of a place below which the aligner says no more."""

LOOSE = np.diag([np.radians(5.0) ** 2] * 3 + [0.15**2] * 3)
"""Covariance of a place that no pair has refined."""

DIGITS = 5
"""Poses are asked about with this many digits, and those equal to them once."""

DRAWN_KEPT = 64
"""Groups of scans whose drawings are kept, 1.4 MB each: what has not moved is drawn once."""


@dataclass(frozen=True)
class PotentialModel:
    """Coefficients of the potential.

    Attributes:
        pair: gives the potential of a pair from its quantities.
        join: log odds of standing with others at all, before anything is known.
        drawn: what the log probability counts that the aligner gives to a place of scans drawn as
            one; typical: where it says nothing.
    """

    pair: ProbabilityModel
    join: float
    drawn: float
    typical: float


@cache
def shipped_potential() -> PotentialModel:
    """The coefficients that come with the package."""
    text = (resources.files("fewview") / "weights" / "potential.json").read_text()
    return potential_from(json.loads(text))


def potential_from(values: Mapping[str, object]) -> PotentialModel:
    """Build a model from the stored JSON."""
    join, drawn, typical = (number(values, name) for name in ("join", "drawn", "typical"))
    return PotentialModel(from_dict(values), join, drawn, typical)


class Together:
    """The scans of a run, each with a completed room, as the global stage asks about them.

    Args:
        scan: gives the prepared scan of an index.
        model: of the potential; the shipped one when not given.
    """

    def __init__(
        self, scan: Callable[[int], PreparedScan], model: PotentialModel | None = None
    ) -> None:
        self._scan = scan
        self._model = shipped_potential() if model is None else model
        self._alignments: dict[tuple[int, int], Alignment] = {}
        self._known: dict[tuple[int, int], dict[bytes, Array]] = {}
        self._drawn_together = lru_cache(DRAWN_KEPT)(self._embedded)

    @property
    def join(self) -> float:
        """Log odds of standing with others at all."""
        return self._model.join

    def potential(self, source: int, target: int, poses: Array, votes: Array) -> Array:
        """(K,) log odds that a pair of scans adds to (K, 4, 4) poses target_T_source.

        Args:
            source, target: indices of the scans.
            poses: of the source in the target.
            votes: (K,) what the candidates of the pair itself add to each, see
                `global_stage.model`.
        """
        rows = self._quantities(source, target, poses)
        rows[:, self._model.pair.features.index(VOTES)] = votes
        return self._model.pair.logits_of(self._model.pair.standard(rows))

    def overlay(self, moving: Mapping[int, Array], fixed: Mapping[int, Array]) -> Overlay:
        """Two groups of scans, each drawn as one.

        Args:
            moving, fixed: (4, 4) poses by scan index, each group in a frame of its own.
        """
        source, target = min(moving), min(fixed)
        return Overlay(
            Alignment(self._drawn(moving, source), self._drawn(fixed, target)),
            self._scan(source),
            self._scan(target),
            moving[source],
            fixed[target],
            self._model if 2 < len(moving) + len(fixed) <= MOST_DRAWN else None,
        )

    def candidate(
        self, source: int, target: int, pose: Array, rank: int, probability: float
    ) -> PoseCandidate:
        """A candidate of a pair that stands together by what other scans say.

        Args:
            source, target: indices of the scans.
            pose: (4, 4) target_T_source.
            rank: after the candidates of the pair itself.
            probability: that it is right.
        """
        found = pair_quantities(
            self._scan(source), self._scan(target), pose[None], self._alignment(source, target)
        )
        evidence = Evidence(
            residual_m=float(found["residual"][0]),
            overlap=float(found["overlap"][0]),
            free_space_violation=float(found["violation"][0] ** 2),
            support=dict.fromkeys(Representation, 0),
        )
        score = float(self.potential(source, target, pose[None], np.zeros(1))[0])
        origin = CandidateOrigin.TOGETHER
        return PoseCandidate(rank, pose, origin, score, probability, evidence, LOOSE)

    def _quantities(self, source: int, target: int, poses: Array) -> Array:
        """(K, d) quantities in the model's order, the votes left at 0."""
        known = self._known.setdefault((source, target), {})
        rounded = poses.round(DIGITS) + 0.0
        keys = [pose.tobytes() for pose in rounded]
        new = [k for k, key in enumerate(keys) if key not in known]
        if new:
            alignment = self._alignment(source, target)
            found = pair_quantities(
                self._scan(source), self._scan(target), rounded[new], alignment
            ) | {VOTES: np.zeros(len(new))}
            rows = np.stack([found[name] for name in self._model.pair.features], axis=1)
            known.update({keys[k]: row for k, row in zip(new, rows, strict=True)})
        return np.array([known[key] for key in keys])

    def _drawn(self, poses: Mapping[int, Array], base: int) -> Embedded:
        """A group of scans on the grid of one of them."""
        others = tuple(i for i in poses if i != base)
        if not others:
            return _above(self._scan(base))
        base_T_other = se3.inverse(poses[base]) @ np.stack([poses[i] for i in others])
        return self._drawn_together(base, others, (base_T_other.round(DIGITS) + 0.0).tobytes())

    def _embedded(self, base: int, others: Sequence[int], base_T_other: bytes) -> Embedded:
        """Scans drawn on the grid of ``base``; the bytes are of (n, 4, 4) poses."""
        drawings = [_above(self._scan(i)).drawing for i in others]
        poses = np.frombuffer(base_T_other).reshape(-1, 4, 4)
        return embed(joint_drawing(_above(self._scan(base)).drawing, drawings, poses))

    def _alignment(self, source: int, target: int) -> Alignment:
        if (source, target) not in self._alignments:
            found = aligned(self._scan(source), self._scan(target))
            assert found is not None
            self._alignments[source, target] = found
        return self._alignments[source, target]


@dataclass(frozen=True)
class Overlay:
    """Two groups of scans, each drawn as one and laid over the other.

    Attributes:
        above: the probability of the places of one drawing over the other.
        source, target: the scan of each group on whose grid it is drawn.
        moving_T_source, fixed_T_target: (4, 4) where these stand in the frames of the groups.
        model: weighs what is above; None for two scans, whose potential holds it already, and for
            more than `MOST_DRAWN`.
    """

    above: Alignment
    source: PreparedScan
    target: PreparedScan
    moving_T_source: Array
    fixed_T_target: Array
    model: PotentialModel | None

    def proposals(self) -> Array:
        """(P, 4, 4) motions fixed_T_moving, the likeliest first."""
        source, target = self.source, self.target
        height = lift(source.scan, target.scan, source.heights, target.heights)
        found = [
            lifted(pose, target.scan, height) for pose in self.above.best(PROPOSED).target_T_source
        ]
        return np.asarray(self.fixed_T_target @ np.stack(found) @ se3.inverse(self.moving_T_source))

    def log_odds(self, motions: Array) -> Array:
        """(K,) what the drawings add to the log odds of (K, 4, 4) motions fixed_T_moving."""
        if self.model is None:
            return np.zeros(len(motions))
        return self.model.drawn * (self.log_mass(motions) - self.model.typical)

    def log_mass(self, motions: Array) -> Array:
        """(K,) log probability around (K, 4, 4) motions fixed_T_moving, `LEAST` at the least."""
        target_T_source = se3.inverse(self.fixed_T_target) @ motions @ self.moving_T_source
        return np.maximum(self.above.log_mass(target_T_source), LEAST)


def pair_quantities(
    source: PreparedScan, target: PreparedScan, poses: Array, alignment: Alignment
) -> dict[str, Array]:
    """Named quantities (K,) of (K, 4, 4) poses target_T_source that the potential weighs.

    All are computed without matching, so that any pose can be asked about.
    """
    levellings = source.scan.levelling, target.scan.levelling
    surface = surface_agreement(source, target, poses)
    visible = visible_agreement(source, target, poses)
    tilt, floor_gap = gravity_disagreement(*levellings, poses)
    return {
        "overlap": surface.overlap,
        "residual": surface.residual_m,
        "colour": surface.colour_gap,
        "concordance": surface.concordance,
        "visible": np.log1p(visible.count),
        "on_surface": visible.on_surface,
        "violation": np.sqrt(visible.in_front),
        "upright": visible.upright_on_surface,
        "upright_seen": np.log1p(visible.upright_count),
        "tilt": np.minimum(tilt, 0.35),
        "floor_gap": np.minimum(floor_gap, 0.5),
        "yaw": yaw_disagreement(*levellings, poses),
        "facing": poses[:, 2, 2],
        "distance": np.linalg.norm(poses[:, :3, 3], axis=1),
        **room_evidence(source, target, poses, alignment),
    }


def _above(scan: PreparedScan) -> Embedded:
    assert scan.above is not None, "only scans with a completed room are asked how they stand"
    return scan.above
