"""The whole way: scans to features, features to pairs, pairs to poses, poses to a mesh."""

from __future__ import annotations

import itertools
import logging
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from fewview import fusion, global_stage
from fewview.completion import complete
from fewview.completion.levelling import turns_upright
from fewview.completion.orientation import glance, quarter_turns
from fewview.config import Config
from fewview.errors import FewviewError
from fewview.executor import Executor
from fewview.matching.prepared import PreparedScan, prepare
from fewview.pairwise import match_pair
from fewview.priors import Priors
from fewview.types import (
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


def reconstruct(
    scans: ScanSet,
    config: Config | None = None,
    seed: int = 0,
    jobs: int | None = None,
    observers: Sequence[Observer] = (),
    priors: Priors | None = None,
) -> Reconstruction:
    """Poses and meshes of a set of scans.

    Args:
        scans: what `fewview.load` returned.
        config: settings; the defaults when not given.
        seed: the same seed and settings give the same result.
        jobs: worker threads; every core when not given.
        observers: are told of every step and cannot change any.
        priors: what is known beforehand, see `fewview.priors.load`.

    Raises:
        ScanError: a scan's pixels cannot be used.
        PriorsError: the priors do not fit the run or contradict each other.
    """
    run = _Run(
        scans, config or Config(), seed, Executor(jobs), tuple(observers), priors or Priors()
    )
    return run.everything()


class _Run:
    """One run: its inputs, its clock and its observers."""

    def __init__(
        self,
        scans: ScanSet,
        config: Config,
        seed: int,
        executor: Executor,
        observers: tuple[Observer, ...],
        priors: Priors,
    ) -> None:
        self.scans = scans
        self.config = config
        self.seed = seed
        self.executor = executor
        self.observers = observers
        self.priors = priors
        self.timings_s: dict[str, float] = {}

    def everything(self) -> Reconstruction:
        self._tell("started", self.scans)
        with self._timed("features"):
            completed = self._complete()
        with self._timed("pairs"):
            pairs = self._match(completed)
        with self._timed("global"):
            solution = global_stage.solve(
                [s.name for s in self.scans.scans],
                [c.levelling for c in completed],
                pairs,
                self.config.global_stage,
                self.seed,
                self.priors.poses,
            )
            self.priors.check(pairs, solution)
            solution = global_stage.refine(
                solution, pairs, completed, self.config.global_stage, self.priors.poses
            )
        self._tell("solved", solution)
        with self._timed("fusion"):
            meshes = self._fuse(solution)
        self._tell("finished", self.timings_s)
        return Reconstruction(
            self.scans,
            completed,
            pairs,
            solution,
            meshes,
            self.timings_s,
            self.seed,
            self.config.hash(),
        )

    def _complete(self) -> tuple[CompletedScan, ...]:
        scans = self.scans.scans
        turns = [0] * len(scans)
        if self.config.features.quarter_turns:
            glances = self.executor.map(lambda s: glance(s.load()), scans)
            turns = quarter_turns(list(glances)).tolist()
            for index, up in self.priors.up.items():
                turns[index] = turns_upright(up)

        def one(index: int) -> tuple[Frame, CompletedScan]:
            frame = scans[index].load()
            features, up = self.config.features, self.priors.up.get(index)
            return frame, complete(
                scans[index].name, frame, turns[index], features, self.seed + index, up
            )

        completed = []
        for index, (frame, result) in enumerate(self.executor.map(one, range(len(scans)))):
            self._tell("scan_completed", index, frame, result)
            completed.append(result)
        return tuple(completed)

    def _match(self, completed: tuple[CompletedScan, ...]) -> tuple[PairResult, ...]:
        prepared: list[PreparedScan] = list(self.executor.map(prepare, completed))

        def one(indices: tuple[int, int]) -> PairResult:
            source, target = indices
            try:
                found = match_pair(prepared[source], prepared[target], indices, self.config)
            except (ValueError, ArithmeticError, RuntimeError) as error:
                log.warning("pair %s failed: %s", indices, error)
                found = PairResult(source, target, PairStatus.FAILED, (), str(error))
            return self.priors.constrain(found)

        results = []
        for result in self.executor.map(one, itertools.combinations(range(len(prepared)), 2)):
            self._tell("pair_matched", result)
            results.append(result)
        return tuple(results)

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
    run = _Run(chosen, config, seed, Executor(1), (), Priors())
    return run._match(run._complete())[0]
