"""Answers: poses, components, meshes, and who watches them being made."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fewview.types.arrays import Array, IntArray
from fewview.types.completed import CompletedScan
from fewview.types.pairs import PairResult, PoseCandidate
from fewview.types.scans import Frame, ScanSet


@dataclass(frozen=True)
class EdgeReport:
    """A selected candidate in the pose graph: its robust weight and its error (m, rad), before
    (graph initialised from the discrete stage) and after optimisation."""

    source: int
    target: int
    rank: int
    weight: float
    before_m: float
    after_m: float
    before_rad: float
    after_rad: float


@dataclass(frozen=True)
class ScanPlacement:
    """Where a scan ended up; without a pose it was not placed, and `reason` says why."""

    name: str
    component: int | None
    world_T_scan: Array | None
    probability: float
    reason: str | None

    @property
    def placed(self) -> bool:
        return self.world_T_scan is not None


@dataclass(frozen=True)
class Registration:
    """What surface points that took no part in a registration say of it.

    Attributes:
        residual_before_m, residual_after_m: their mean distance from the surfaces of other scans.
        accepted: whether the refined poses were kept.
    """

    residual_before_m: float
    residual_after_m: float
    accepted: bool


@dataclass(frozen=True)
class Component:
    """A set of scans that share one world frame.

    Attributes:
        scans: their indices, ascending.
        world: ``"floor"`` (z up, floor at z = 0), ``"gravity"`` (first scan's position, z up) or
            ``"given"`` (the frame of the poses that the user fixed).
        nearest_link: the best rejected candidate that would have joined it to another component,
            as text, or None.
        registration: outcome of refining its poses by the surfaces of all its scans, None where
            that was not asked for or no surfaces meet.
    """

    scans: tuple[int, ...]
    world: str
    nearest_link: str | None = None
    registration: Registration | None = None


@dataclass(frozen=True)
class AlternativePlace:
    """Where a scan stands in an alternative.

    Attributes:
        scan: its index.
        component: whose world the pose is in; numbers after the answer's are components of the
            alternative's own; None where the alternative leaves the scan alone.
        world_T_scan: (4, 4), before any pose graph, or None.
    """

    scan: int
    component: int | None
    world_T_scan: Array | None


@dataclass(frozen=True)
class Alternative:
    """Another answer of the discrete stage.

    Attributes:
        margin: log posterior of the best labelling minus its own, at least 0; 0 for the best
            itself, which is an alternative where doubtful scans were dropped from it.
        places: of the scans that stand otherwise than in the answer, ascending.
    """

    margin: float
    places: tuple[AlternativePlace, ...]

    @property
    def odds(self) -> float:
        """Posterior odds against the best labelling."""
        return math.exp(-self.margin)


@dataclass(frozen=True)
class GlobalSolution:
    """The answer of the global stage.

    Attributes:
        placements: one per scan, in the order of the scans.
        components: largest first.
        selected: (source, target) -> rank of the chosen candidate; absent means none.
        initial_world_T_scan: poses before the pose graph, same gauge as the placements.
        edges: one per selected candidate.
        alternatives: other answers, most probable first.
        found: (source, target) -> candidate of a pair that the stage itself proposed and selected,
            ranked after the pair's own.
    """

    placements: tuple[ScanPlacement, ...]
    components: tuple[Component, ...]
    selected: Mapping[tuple[int, int], int]
    initial_world_T_scan: Mapping[int, Array]
    edges: tuple[EdgeReport, ...]
    alternatives: tuple[Alternative, ...] = ()
    found: Mapping[tuple[int, int], PoseCandidate] = field(default_factory=dict)

    def with_found(self, pairs: Sequence[PairResult]) -> tuple[PairResult, ...]:
        """The pairs that were solved, each with the candidate found for it, if any.

        One candidate of a pair at most is right: what a found one is believed with is taken from
        the others.
        """
        return tuple(self._with_found(pair) for pair in pairs)

    def _with_found(self, pair: PairResult) -> PairResult:
        found = self.found.get((pair.source, pair.target))
        if found is None:
            return pair
        left = 1.0 - found.probability
        others = (replace(c, probability=left * c.probability) for c in pair.candidates)
        return replace(pair, candidates=(*others, found))

    @property
    def headline(self) -> str:
        """How many scans share one world, and of how many components that is the largest."""
        count = len(self.components)
        largest = len(self.components[0].scans) if count else 0
        where = "placed" if count < 2 else f"in the largest of {count} components"
        return f"{largest} of {len(self.placements)} scans {where}"


@dataclass(frozen=True)
class ColouredMesh:
    """A triangle mesh: vertices (n, 3) float64 metres, faces (m, 3) int64, colours (n, 3) uint8."""

    vertices: Array
    faces: IntArray
    colours: NDArray[np.uint8]


@dataclass(frozen=True)
class Reconstruction:
    """The whole result of a run.

    Attributes:
        scans: what was read.
        completed: one per scan, same order.
        pairs: one per unordered pair, source < target.
        solution: poses and components.
        meshes: one per component, same order.
        timings_s: wall seconds per stage.
        seed: the run's seed.
        config_hash: fingerprint of the settings.
    """

    scans: ScanSet
    completed: tuple[CompletedScan, ...]
    pairs: tuple[PairResult, ...]
    solution: GlobalSolution
    meshes: tuple[ColouredMesh, ...]
    timings_s: Mapping[str, float]
    seed: int
    config_hash: str


class Observer(Protocol):
    """Watches a run without being able to change it: progress bars, the recording.

    Methods are called from one thread, scans and pairs in index order.
    """

    def started(self, scans: ScanSet) -> None:
        """The folder was read; nothing was computed yet."""

    def scan_completed(self, index: int, frame: Frame, completed: CompletedScan) -> None:
        """The features of one scan are known."""

    def pair_matched(self, result: PairResult) -> None:
        """One pair has its candidates."""

    def solved(self, solution: GlobalSolution) -> None:
        """The global stage has decided."""

    def mesh_fused(self, component: int, mesh: ColouredMesh) -> None:
        """The mesh of one component is done."""

    def finished(self, timings_s: Mapping[str, float]) -> None:
        """Everything is done; wall seconds per stage."""
