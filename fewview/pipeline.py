"""The whole way: scans to features, features to pairs, pairs to poses, poses to a mesh."""

from __future__ import annotations

import hashlib
import itertools
import logging
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TypeVar

from fewview import fusion, global_stage
from fewview.completion import complete
from fewview.completion.levelling import turns_upright
from fewview.completion.orientation import Glance, glance, quarter_turns
from fewview.config import Config, FeatureConfig
from fewview.errors import FewviewError
from fewview.executor import Executor
from fewview.matching.prepared import PreparedScan, prepare
from fewview.pairwise import match_pair
from fewview.priors import Priors
from fewview.records import digest
from fewview.store import Store
from fewview.together import Together
from fewview.types import (
    Array,
    ColouredMesh,
    CompletedScan,
    Frame,
    GlobalSolution,
    Observer,
    PairResult,
    PairStatus,
    Reconstruction,
    ScanSet,
)

log = logging.getLogger(__name__)
Record = TypeVar("Record")


def reconstruct(
    scans: ScanSet,
    config: Config | None = None,
    seed: int = 0,
    jobs: int | None = None,
    observers: Sequence[Observer] = (),
    priors: Priors | None = None,
    store: Store | None = None,
) -> Reconstruction:
    """Poses and meshes of a set of scans.

    Args:
        scans: what `fewview.load` returned.
        config: settings; the defaults when not given.
        seed: the same seed and settings give the same result.
        jobs: worker threads; every core when not given.
        observers: are told of every step and cannot change any.
        priors: what is known beforehand, see `fewview.priors.load`.
        store: keeps scans and pairs between runs; the result is the same with and without.

    Raises:
        ScanError: a scan's pixels cannot be used.
        PriorsError: the priors do not fit the run or contradict each other.
    """
    run = _Run(scans, config or Config(), seed, Executor(jobs), tuple(observers), priors, store)
    return run.everything()


@dataclass(frozen=True)
class Origin:
    """All that a completed scan is a function of: other scans of the set are no part of it.

    Attributes:
        pixels: fingerprint of its frame; empty where nothing is stored.
        name, quarter_turns, features, seed, up: see `complete`.
    """

    pixels: str
    name: str
    quarter_turns: int
    features: FeatureConfig
    seed: int
    up: Array | None

    def complete(self, frame: Frame) -> CompletedScan:
        """The scan completed from its pixels."""
        return complete(self.name, frame, self.quarter_turns, self.features, self.seed, self.up)


def scan_seed(seed: int, name: str) -> int:
    """The seed of one scan: it follows from the run's and the scan's name, not from its place."""
    return int.from_bytes(hashlib.sha256(f"{seed}/{name}".encode()).digest()[:8])


class _Run:
    """One run: its inputs, its clock and its observers."""

    def __init__(
        self,
        scans: ScanSet,
        config: Config,
        seed: int,
        executor: Executor,
        observers: tuple[Observer, ...] = (),
        priors: Priors | None = None,
        store: Store | None = None,
    ) -> None:
        self.scans = scans
        self.config = config
        self.seed = seed
        self.executor = executor
        self.observers = observers
        self.priors = priors or Priors()
        self.store = store
        self.prepared: dict[int, PreparedScan] = {}
        self.timings_s: dict[str, float] = {}

    def everything(self) -> Reconstruction:
        self._tell("started", self.scans)
        with self._timed("features"):
            origins = self._origins()
            completed = self._complete(origins)
        with self._timed("pairs"):
            pairs = self._match(completed, origins)
        with self._timed("global"):
            solution = self._solve(completed, pairs)
        self._tell("solved", solution)
        with self._timed("fusion"):
            meshes = self._fuse(solution)
        self._tell("finished", self.timings_s)
        return Reconstruction(
            self.scans,
            completed,
            solution.with_found(pairs),
            solution,
            meshes,
            self.timings_s,
            self.seed,
            self.config.hash(),
        )

    def _origins(self) -> list[Origin]:
        """Every scan's pixels are read before anything is kept: if one is unusable, nothing is."""
        scans, features = self.scans.scans, self.config.features
        pixels, turns = [""] * len(scans), [0] * len(scans)
        if self.store is not None:
            pixels = list(self.executor.map(lambda s: digest(s.load()), scans))

        def look(index: int) -> Glance:
            return self._kept(Glance, pixels[index], lambda: glance(scans[index].load()))

        if features.quarter_turns:
            glances = self.executor.map(look, range(len(scans)))
            turns = quarter_turns(list(glances)).tolist()
            for index, up in self.priors.up.items():
                turns[index] = turns_upright(up)
        return [
            Origin(
                pixels[i],
                scan.name,
                turns[i],
                features,
                scan_seed(self.seed, scan.name),
                self.priors.up.get(i),
            )
            for i, scan in enumerate(scans)
        ]

    def _complete(self, origins: Sequence[Origin]) -> tuple[CompletedScan, ...]:
        def one(index: int) -> tuple[Frame, CompletedScan]:
            frame, origin = self.scans.scans[index].load(), origins[index]
            return frame, self._kept(CompletedScan, origin, lambda: origin.complete(frame))

        completed = []
        for index, (frame, result) in enumerate(self.executor.map(one, range(len(origins)))):
            self._tell("scan_completed", index, frame, result)
            completed.append(result)
        return tuple(completed)

    def _match(
        self, completed: Sequence[CompletedScan], origins: Sequence[Origin]
    ) -> tuple[PairResult, ...]:
        settings = self.config.matching, self.config.refinement
        pairs = list(itertools.combinations(range(len(completed)), 2))
        origin = {pair: (*(origins[scan] for scan in pair), *settings) for pair in pairs}
        known = {pair: found for pair in pairs if (found := self._get(PairResult, origin[pair]))}
        needed = sorted({scan for pair in pairs if pair not in known for scan in pair})
        searched = self.executor.map(lambda scan: self._prepared(completed, scan), needed)
        prepared = dict(zip(needed, searched, strict=True))

        def one(pair: tuple[int, int]) -> PairResult:
            source, target = pair
            if pair in known:
                return replace(known[pair], source=source, target=target)
            try:
                found = match_pair(prepared[source], prepared[target], pair, self.config)
            except (ValueError, ArithmeticError, RuntimeError) as error:
                log.warning("pair %s failed: %s", pair, error)
                return PairResult(source, target, PairStatus.FAILED, (), str(error))
            self._put(found, origin[pair])
            return found

        results = []
        for found in self.executor.map(one, pairs):
            result = self.priors.constrain(found)
            self._tell("pair_matched", result)
            results.append(result)
        return tuple(results)

    def _solve(
        self, completed: Sequence[CompletedScan], pairs: Sequence[PairResult]
    ) -> GlobalSolution:
        config, fixed = self.config.global_stage, self.priors.poses
        foreseen = config.together and all(scan.room.layout is not None for scan in completed)

        def prepared(scan: int) -> PreparedScan:
            return self._prepared(completed, scan)

        solution = global_stage.solve(
            [scan.name for scan in completed],
            [scan.levelling for scan in completed],
            pairs,
            config,
            self.seed,
            fixed,
            Together(prepared) if foreseen else None,
        )
        pairs = solution.with_found(pairs)
        self.priors.check(pairs, solution)
        return global_stage.refine(solution, pairs, completed, config, fixed)

    def _prepared(self, completed: Sequence[CompletedScan], scan: int) -> PreparedScan:
        if scan not in self.prepared:
            self.prepared[scan] = prepare(completed[scan])
        return self.prepared[scan]

    def _fuse(self, solution: GlobalSolution) -> tuple[ColouredMesh, ...]:
        meshes = []
        for number, component in enumerate(solution.components):
            placed = (
                (self.scans.scans[i].load(), pose)
                for i in component.scans
                if (pose := solution.placements[i].world_T_scan) is not None
            )
            mesh = fusion.fuse(placed, self.config.fusion)
            self._tell("mesh_fused", number, mesh)
            meshes.append(mesh)
        return tuple(meshes)

    def _kept(self, kind: type[Record], origin: object, make: Callable[[], Record]) -> Record:
        """The stored record of an origin, or the one that is made of it and then stored."""
        found = self._get(kind, origin)
        if found is None:
            found = make()
            self._put(found, origin)
        return found

    def _get(self, kind: type[Record], origin: object) -> Record | None:
        return None if self.store is None else self.store.get(kind, origin)

    def _put(self, record: object, origin: object) -> None:
        if self.store is not None:
            self.store.put(record, origin)

    def _tell(self, event: str, *arguments: object) -> None:
        with self._timed("recording"):
            for observer in self.observers:
                getattr(observer, event)(*arguments)

    @contextmanager
    def _timed(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.timings_s[stage] = self.timings_s.get(stage, 0.0) + time.perf_counter() - start


def match_two(
    scans: ScanSet, source: str, target: str, config: Config, seed: int = 0
) -> PairResult:
    """Top-K relative poses of two scans of a set, by name.

    Raises:
        FewviewError: a name is not in the set, or both are the same.
    """
    by_name = {s.name: s for s in scans.scans}
    for name in (source, target):
        if name not in by_name:
            known = ", ".join(sorted(by_name)[:8])
            raise FewviewError(f"there is no scan '{name}'; there are {known} ...")
    if source == target:
        raise FewviewError(f"a pair needs two different scans; '{source}' was given twice")
    chosen = ScanSet(
        scans.format, (by_name[source], by_name[target]), scans.depth_unit_m, scans.notes
    )
    run = _Run(chosen, config, seed, Executor(1))
    origins = run._origins()
    return run._match(run._complete(origins), origins)[0]
