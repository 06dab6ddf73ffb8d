"""Potentials of scans with known poses: what `fewview.together` answers, by construction."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from benchmark.planted_graphs import candidate, room_poses
from fewview.geometry import se3
from fewview.types import Array, CandidateOrigin, PoseCandidate

SAME_RAD, SAME_M = np.radians(5.0), 0.1
MOST_VOTES = 10.0


@dataclass(frozen=True)
class PlantedOverlay:
    """Proposals, and what is added to the log odds of all motions that are one of them."""

    motions: Array
    drawn: float

    def proposals(self) -> Array:
        """As planted."""
        return self.motions

    def log_odds(self, motions: Array) -> Array:
        """``drawn`` for proposals, else nothing."""
        turn, shift = se3.distance(motions[:, None], self.motions)
        return self.drawn * ((turn < SAME_RAD) & (shift < SAME_M)).any(axis=1)


@dataclass
class Planted:
    """Two scans speak for a few ways of standing to each other and against all others.

    Attributes:
        places: of each scan, (k, 4, 4) world_T_scan it may have, the true one first.
        said: (source, target) -> (k, l) potential of the source at its k-th and the target at its
            l-th place; where it is missing, 4 for both at the true ones and ``elsewhere`` for the
            rest.
        elsewhere: potential of any other relative pose.
        join: log odds of a join.
        asked: every pair that was asked, as often as it was.
        drawn: what scans drawn as one add to the log odds of the places that they propose.
    """

    places: Sequence[Array]
    said: Mapping[tuple[int, int], Array] = field(default_factory=dict)
    elsewhere: float = -3.0
    join: float = -1.0
    asked: list[tuple[int, int]] = field(default_factory=list)
    drawn: float = 0.0

    def potential(self, source: int, target: int, poses: Array, votes: Array) -> Array:
        """What is said of the way at which a pose is, and votes, of which more count no more."""
        self.asked.append((source, target))
        ways = self._ways(source, target)
        turn, shift = se3.distance(poses[:, None], ways.reshape(-1, 4, 4))
        near = (turn < SAME_RAD) & (shift < SAME_M)
        said = self._said(source, target).ravel()[np.argmax(near, axis=1)]
        here = np.where(near.any(axis=1), said, self.elsewhere)
        return np.asarray(here + np.minimum(votes, MOST_VOTES))

    def overlay(self, moving: Mapping[int, Array], fixed: Mapping[int, Array]) -> PlantedOverlay:
        """Every motion that brings a scan of one group to one of the ways to one of the other, the
        true ones last."""
        found = [
            fixed[j] @ way @ se3.inverse(moving[i])
            for i, j in itertools.product(moving, fixed)
            for way in self._ways(i, j).reshape(-1, 4, 4)
        ]
        return PlantedOverlay(np.stack(found[::-1]), self.drawn)

    def candidate(
        self, source: int, target: int, pose: Array, rank: int, probability: float
    ) -> PoseCandidate:
        """With plausible evidence."""
        made = candidate(rank, pose, probability)
        return replace(made, origin=CandidateOrigin.TOGETHER)

    def _ways(self, source: int, target: int) -> Array:
        """(k, l, 4, 4) target_T_source."""
        world_T_target = self.places[target]
        return se3.inverse(world_T_target)[None] @ self.places[source][:, None]

    def _said(self, source: int, target: int) -> Array:
        plain = np.full((len(self.places[source]), len(self.places[target])), self.elsewhere)
        plain[0, 0] = 4.0
        return self.said.get((source, target), plain)


def places_of(seed: int, scans: int, count: int = 2) -> list[Array]:
    """``count`` places in a room for every scan."""
    drawn = room_poses(np.random.default_rng(seed), scans * count)
    return list(drawn.reshape(scans, count, 4, 4))
