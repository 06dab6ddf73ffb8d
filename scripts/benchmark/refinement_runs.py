"""Local refinements from starts near the truth, kept on disk.

The starts are the paper's perturbation of the truth (Sec. 4), and nearer ones that still count as
right: a refinement should bring the first nearer and not spoil the second.
"""

from __future__ import annotations

import time
import zlib
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.catalogue import key_of
from benchmark.scenes import Scene
from benchmark.store import Record, Store
from fewview.evaluation.metrics import (
    RIGHT_DEG,
    RIGHT_M,
    relative,
    rotation_error_deg,
    translation_error_m,
    within,
)
from fewview.evaluation.relations import perturbed
from fewview.geometry import se3
from fewview.types import Array

LOCALS_MODULE = "benchmark.methods.local"
START = "start"
"""The row of what refinements are given."""
STARTS = 5
"""Starts of each kind for a pair, refined together: as many as a pair has candidates."""
PERTURBED = "perturbed"
RIGHT = "right"
FARTHEST: Mapping[str, tuple[float, float]] = {
    PERTURBED: (30.0, 0.5),
    RIGHT: (RIGHT_DEG, RIGHT_M),
}
"""Degrees and metres an axis by which starts of a kind are off the truth at most; of the second
kind only those are taken whose whole translation is within the tolerance too."""
SURFACE_POINTS = 500


@dataclass(frozen=True)
class Errors:
    """How far `STARTS` poses are off the truth.

    Attributes:
        rotation_deg, translation_m: (STARTS,) as elsewhere.
        surface_m: (STARTS,) mean distance by which the source's measured points are off.
    """

    rotation_deg: Array
    translation_m: Array
    surface_m: Array

    @staticmethod
    def of(truth: Array, poses: Array, points: Array) -> Errors:
        """Those of (STARTS, 4, 4) poses; ``points`` (n, 3) of the source in its own frame."""
        off = se3.transform(poses, points) - se3.transform(truth, points)
        return Errors(
            rotation_error_deg(truth, poses),
            translation_error_m(truth, poses),
            np.asarray(np.linalg.norm(off, axis=-1).mean(axis=-1)),
        )


Outcome = dict[str, dict[str, Errors]]
"""Kind of start -> name of a refinement, or `START` -> errors."""


@dataclass(frozen=True)
class RefinementTask:
    """All local refinements on two scans of a scene.

    Attributes:
        locals: keys of `benchmark.methods.local.LOCALS`.
        seed: of the starts.
    """

    store: Store
    scene: Scene
    source: str
    target: str
    seed: int
    locals: tuple[str, ...]

    @property
    def path(self) -> Path:
        key = key_of("refinement", [list(self.locals), STARTS], [__name__, LOCALS_MODULE])
        name = f"{self.source}~{self.target}~{self.seed}"
        return self.store.path(self.scene.key, key, name)

    @property
    def group(self) -> tuple[Hashable, ...]:
        return "refinement", self.scene.name

    def run(self) -> Record[Outcome]:
        """Refine from all starts; seconds are those of one pair with `STARTS` candidates."""
        from benchmark.methods.local import LOCALS

        poses = self.scene.truth
        truth = relative(poses[self.source], poses[self.target])
        points = self.scene.cloud(self.source)
        points = points[np.linspace(0, len(points) - 1, SURFACE_POINTS).astype(np.int64)]
        key = zlib.crc32(f"{self.scene.name} {self.source} {self.target}".encode())
        rng = np.random.default_rng([self.seed, key])
        begun = {kind: starts(truth, kind, rng) for kind in FARTHEST}
        found: Outcome = {k: {START: Errors.of(truth, s, points)} for k, s in begun.items()}
        seconds = {}
        for name in self.locals:
            views = [_view(name, self.scene, scan) for scan in (self.source, self.target)]
            taken = time.process_time()
            for kind, start in begun.items():
                refined = LOCALS[name].refine(views[0], views[1], start)
                found[kind][name] = Errors.of(truth, refined, points)
            seconds[name] = (time.process_time() - taken) / len(begun)
        return Record(found, seconds)


def starts(target_T_source: Array, kind: str, rng: np.random.Generator) -> Array:
    """(STARTS, 4, 4) poses off the truth (4, 4) by at most what `FARTHEST` says of their kind."""
    farthest = FARTHEST[kind]
    found: list[Array] = []
    while len(found) < STARTS:
        pose = perturbed(target_T_source, rng, *farthest)
        errors = (
            rotation_error_deg(target_T_source, pose),
            translation_error_m(target_T_source, pose),
        )
        if kind != RIGHT or within(*errors):
            found.append(pose)
    return np.stack(found)


@lru_cache(256)
def _view(local: str, scene: Scene, name: str) -> Any:
    from benchmark.methods.local import LOCALS

    return LOCALS[local].prepare(scene.load(name), 0)
