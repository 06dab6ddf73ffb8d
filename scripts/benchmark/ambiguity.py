"""Sets of scans that invite confident mistakes, and what is wrong in an answer to one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmark.corridors import Likeness, corridor, corridor_views
from fewview import synthetic
from fewview.evaluation.gauge import absolute_errors
from fewview.evaluation.metrics import (
    relative,
    rotation_error_deg,
    translation_error_m,
    within,
)
from fewview.geometry import se3
from fewview.types import (
    Alternative,
    Array,
    BoolArray,
    Frame,
    GlobalSolution,
    PairResult,
    Reconstruction,
    Scan,
    ScanSet,
)

Json = dict[str, Any]
Size = tuple[int, int]
APART_M = 1000.0
"""Rooms of one folder stand this far apart, so that every pose between them is wrong."""


@dataclass(frozen=True, eq=False)
class Mixture:
    """Scans with their truth.

    Attributes:
        name: of the set.
        scans: what a run is given.
        truth: (n, 4, 4) world_T_scan.
        place: (n,) which of the places that should not be confused each scan shows: the room,
            or the part of a corridor.
    """

    name: str
    scans: ScanSet
    truth: Array
    place: Sequence[str]


@dataclass(frozen=True)
class _Held:
    """Pixels in memory."""

    frame: Frame

    def load(self) -> Frame:
        return self.frame


def two_rooms(indices: tuple[int, int], scans: int, seed: int, size: Size = (640, 480)) -> Mixture:
    """Scans of two generated rooms of the test split, those of each room tied by overlap.

    Args:
        indices: of the rooms in the split.
        scans: of each room.
        seed: which views.
        size: width and height of the images, pixels.
    """
    scenes = [
        synthetic.generate(synthetic.split_seed("test", index), scans, seed, "spread", *size)
        for index in indices
    ]
    far = [se3.pose(np.eye(3), np.array([room * APART_M, 0.0, 0.0])) for room in range(2)]
    truth = [far[room] @ scene.poses[n] for room, scene in enumerate(scenes) for n in scene.names]
    place = [name for name in "AB" for _ in range(scans)]
    frames = [frame for scene in scenes for frame in scene.frames]
    return _mixture(f"rooms {indices[0]} + {indices[1]}", frames, truth, place)


def look_alike(
    likeness: Likeness, each: int, middle: int, seed: int, size: Size = (640, 480)
) -> Mixture:
    """Scans of a corridor whose halves look alike; see `corridor_views` for the arguments."""
    rng = np.random.default_rng(seed)
    room, camera = corridor(seed, likeness), synthetic.kinect(*size)
    poses = corridor_views(room, each, middle, seed, camera)
    frames = [synthetic.render(room, pose, camera, rng) for pose in poses]
    place = ["first"] * each + ["middle"] * middle + ["second"] * each
    tied = "tied by the middle" if middle else "apart"
    return _mixture(f"{likeness} {seed}, halves {tied}", frames, poses, place)


def _mixture(
    name: str, frames: Sequence[Frame], truth: Sequence[Array], place: Sequence[str]
) -> Mixture:
    scans = [
        Scan(f"scan-{i:03d}", frame.intrinsics, _Held(frame)) for i, frame in enumerate(frames)
    ]
    return Mixture(name, ScanSet("memory", tuple(scans), 0.001), np.stack(truth), tuple(place))


def score(mixture: Mixture, result: Reconstruction) -> Json:
    """What is wrong in an answer, and whether the right one is among its alternatives.

    A scan is wrong when it is more than 15 degrees or 0.3 m off where the largest agreeing group
    of its component says that it should stand; where no two scans agree, all are.
    """
    solution, truth = result.solution, mixture.truth
    wrong = wrong_scans(truth, *_answer(solution))
    probability = np.array([p.probability for p in solution.placements])
    surest = float(probability[wrong].max(initial=0.0))
    repaired = [_right(truth, solution, other) for other in solution.alternatives]
    return {
        "name": mixture.name,
        "components": [[mixture.place[i] for i in c.scans] for c in solution.components],
        "placed": sum(p.placed for p in solution.placements),
        "wrong": np.flatnonzero(wrong).tolist(),
        "surest_wrong": surest,
        "truth_among_alternatives": any(repaired) if wrong.any() else None,
        "alternatives": [other.odds for other in solution.alternatives],
        "surest_wrong_candidate": _surest_wrong_candidate(result.pairs, truth),
        "probabilities": probability.tolist(),
        "seconds": dict(result.timings_s),
    }


def wrong_scans(
    truth: Array, component: Sequence[int | None], world_T_scan: Sequence[Array | None]
) -> BoolArray:
    """(n,) scans that stand wrong in their component; scans alone never do."""
    wrong = np.zeros(len(truth), dtype=bool)
    for label in {c for c in component if c is not None}:
        inside = [p if c == label else None for p, c in zip(world_T_scan, component, strict=True)]
        errors = absolute_errors(truth, inside)
        wrong |= errors.placed & ~errors.agreeing
    return wrong


def _answer(solution: GlobalSolution) -> tuple[list[int | None], list[Array | None]]:
    placements = solution.placements
    return [p.component for p in placements], [p.world_T_scan for p in placements]


def _right(truth: Array, solution: GlobalSolution, other: Alternative) -> bool:
    """Whether no scan stands wrong in an alternative."""
    component, poses = _answer(solution)
    for place in other.places:
        component[place.scan], poses[place.scan] = place.component, place.world_T_scan
    return not wrong_scans(truth, component, poses).any()


def _surest_wrong_candidate(pairs: Sequence[PairResult], truth: Array) -> float:
    """The highest probability that a pair gave to a wrong candidate."""
    return max((p for pair in pairs for p in _wrong_candidates(pair, truth)), default=0.0)


def _wrong_candidates(pair: PairResult, truth: Array) -> Iterator[float]:
    true = relative(truth[pair.source], truth[pair.target])
    for candidate in pair.candidates:
        pose = candidate.target_T_source
        if not within(rotation_error_deg(true, pose), translation_error_m(true, pose)):
            yield candidate.probability
