"""Progress for people: a bar with an estimate on a terminal, plain lines otherwise."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import TextIO

from tqdm import tqdm

from fewview.types import (
    ColouredMesh,
    CompletedScan,
    Frame,
    GlobalSolution,
    PairResult,
    PairStatus,
    ScanSet,
)

LINES_PER_STAGE = 5


class Progress:
    """An observer that reports to a stream, standard error when none is given."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self.stream = stream or sys.stderr
        self.bar: tqdm[None] | None = None
        self.total = 0
        self.done = 0
        self.believable = 0

    def started(self, scans: ScanSet) -> None:
        count = len(scans.scans)
        self._say(f"{count} scans, {scans.format} layout, depth unit {scans.depth_unit_m:g} m")
        for note in scans.notes:
            self._say(f"note: {note}")
        self._begin("features", count)

    def scan_completed(self, index: int, frame: Frame, completed: CompletedScan) -> None:
        self._advance("features")
        if self.done == self.total:
            self._begin("pairs", self.total * (self.total - 1) // 2)

    def pair_matched(self, result: PairResult) -> None:
        self.believable += result.status is PairStatus.OK
        self._advance("pairs")

    def solved(self, solution: GlobalSolution) -> None:
        self._end()
        self._say(f"{self.believable} of {self.total} pairs believable; {solution.headline}")
        for placement in solution.placements:
            if not placement.placed:
                self._say(f"not placed: {placement.name}: {placement.reason}")

    def mesh_fused(self, component: int, mesh: ColouredMesh) -> None:
        self._say(f"mesh of component {component}: {len(mesh.vertices)} vertices")

    def finished(self, timings_s: Mapping[str, float]) -> None:
        stages = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in timings_s.items())
        self._say(f"done: {stages}")

    def _begin(self, stage: str, total: int) -> None:
        self._end()
        self.total, self.done = total, 0
        if self.stream.isatty():
            self.bar = tqdm(total=total, desc=stage, file=self.stream, leave=False)

    def _advance(self, stage: str) -> None:
        self.done += 1
        if self.bar is not None:
            self.bar.update()
        elif self.done == self.total or self.done % max(1, self.total // LINES_PER_STAGE) == 0:
            self._say(f"{stage} {self.done}/{self.total}")

    def _end(self) -> None:
        if self.bar is not None:
            self.bar.close()
            self.bar = None

    def _say(self, line: str) -> None:
        print(line, file=self.stream, flush=True)
