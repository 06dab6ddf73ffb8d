"""Rooms and folders with sets of scans, and guests that stand nowhere among them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from fewview.completion import complete
from fewview.config import Config
from fewview.evaluation.overlap import overlap_matrix
from fewview.executor import Executor
from fewview.geometry.camera import backproject
from fewview.matching.prepared import PreparedScan, prepare
from fewview.pairwise import match_pair
from fewview.types import Array, Frame, PairResult
from validation_views import Views, corridor_views, folder_views, strangers, twins, views

VIEWS, SIZE, MAX_OVERLAP = 16, 5, 0.1
EXTREME_SETS, RANDOM_SETS = 2, 1
GUESTS, ROOMS_ASKED = 2, 9
SETS_OF_A_FOLDER, SETS_OF_A_CORRIDOR = (6, 4), 2


@dataclass(frozen=True)
class Matched:
    """A scene with its pairs.

    Attributes:
        sets: kind and views of each.
        guests: kind and two views of each.
        poses: (n, 4, 4) true world_T_scan; those of guests are right among themselves.
        scans: of the sets, and the guests.
    """

    sets: list[tuple[str, list[int]]]
    guests: list[tuple[str, list[int]]]
    poses: Array
    scans: Mapping[int, PreparedScan]

    @cached_property
    def _pairs(self) -> dict[tuple[int, int], PairResult]:
        return {}

    def pair(self, i: int, j: int) -> PairResult:
        """The candidates of two scans, the first with the smaller index; matched when asked for."""
        if (i, j) not in self._pairs:
            self._pairs[i, j] = match_pair(self.scans[i], self.scans[j], (i, j), Config())
        return self._pairs[i, j]


def room(index: int, warped: bool) -> Matched:
    """A generated room of the validation split, strangers from the next that has a place, twins."""
    frames, poses = views(index, VIEWS, warped=warped)
    guests = {
        "strangers": strangers(range(index + 1, index + ROOMS_ASKED), GUESTS, warped),
        "twins": twins(frames[:GUESTS], poses[:GUESTS]),
    }
    return matched(frames, poses, EXTREME_SETS, RANDOM_SETS, index, guests)


def corridor(index: int, warped: bool) -> Matched:
    """A corridor whose halves look alike."""
    return matched(*corridor_views(index, warped), 0, SETS_OF_A_CORRIDOR, index)


def folder(path: Path) -> Matched:
    """Scans with ground truth."""
    return matched(*folder_views(path), *SETS_OF_A_FOLDER, seed=0)


def matched(
    frames: Sequence[Frame],
    poses: Array,
    extreme: int,
    random: int,
    seed: int,
    guests: Mapping[str, Views] | None = None,
) -> Matched:
    """Draw sets of views and complete their scans and the guests."""
    config, rng = Config(), np.random.default_rng(seed)
    clouds = [
        backproject(frame.depth, frame.intrinsics)[frame.depth > 0].astype(np.float64)
        for frame in frames
    ]
    sets = [("extreme", found) for found in apart(overlap_matrix(clouds, poses), extreme, rng)]
    for _ in range(random):
        sets.append(("random", sorted(rng.choice(len(frames), SIZE, replace=False).tolist())))
    needed = sorted({i for _, members in sets for i in members})
    everything, known, invited = list(frames), [poses], []
    for kind, (shown, where) in (guests or {}).items():
        invited.append((kind, list(range(len(everything), len(everything) + len(shown)))))
        needed += invited[-1][1]
        everything += shown
        known.append(where)

    def one(i: int) -> PreparedScan:
        return prepare(complete(str(i), everything[i], 0, config.features, i))

    scans = dict(zip(needed, Executor().map(one, needed), strict=True))
    return Matched(sets, invited, np.concatenate(known), scans)


def apart(overlap: Array, count: int, rng: np.random.Generator) -> list[list[int]]:
    """Sets of views no two of which share more than `MAX_OVERLAP`."""
    found: list[list[int]] = []
    for _ in range(300):
        if len(found) == count:
            break
        chosen: list[int] = []
        for i in rng.permutation(len(overlap)).tolist():
            if len(chosen) < SIZE and all(overlap[i, j] <= MAX_OVERLAP for j in chosen):
                chosen.append(i)
        if len(chosen) == SIZE and all(len({*chosen} & {*other}) < SIZE - 1 for other in found):
            found.append(sorted(chosen))
    return found
