"""Generated rooms as phase two sees them: completed scans, candidate matches and the truth."""

from __future__ import annotations

import hashlib
import itertools
import pickle
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from fewview import synthetic, weights
from fewview.completion import complete
from fewview.completion.scan import COMPLETED_KINDS, OBSERVED_KINDS
from fewview.config import Config
from fewview.evaluation.overlap import overlap_matrix
from fewview.executor import Executor
from fewview.geometry import se3
from fewview.geometry.camera import backproject
from fewview.matching.consistency import CandidateMatches, stack
from fewview.matching.heights import height_profile, lift
from fewview.synthetic import Split, SyntheticScene
from fewview.types import Array, CompletedRoom, CompletedScan, Frame

Part = Literal["observed", "completed"]
"""The two spectral passes: between what scans show, and between completed rooms."""
FIRST_ROOM = {"train": 3_000_000, "validation": 0}
"""Completions are better in rooms that the networks know: they learned in rooms of the training
split below this one."""


@dataclass(frozen=True)
class ScanPair:
    """Two scans of a room.

    Attributes:
        source, target: their numbers in the room.
        target_T_source: (4, 4) the truth.
        overlap: true overlap 0..1.
        observed, completed: candidate matches of either spectral pass.
        source_lift: see `heights.lift`.
    """

    source: int
    target: int
    target_T_source: Array
    overlap: float
    observed: CandidateMatches
    completed: CandidateMatches
    source_lift: float

    def candidates(self, part: Part) -> CandidateMatches:
        """The matches of one pass."""
        return self.observed if part == "observed" else self.completed


@dataclass(frozen=True)
class ScannedRoom:
    """Scans of a room, without pixels, features and descriptors, and all pairs of them."""

    name: str
    scans: tuple[CompletedScan, ...]
    pairs: tuple[ScanPair, ...]


def rooms(
    split: Split, count: int, views: int, config: Config, cache: Path, executor: Executor
) -> Iterator[ScannedRoom]:
    """The first rooms of a split, kept in ``cache`` until what makes them changes."""
    folder = cache / f"rooms-{_key(config, views)}"
    folder.mkdir(parents=True, exist_ok=True)
    for i in range(count):
        path = folder / f"{split}-{i:03d}.pickle"
        if not path.is_file():
            partial = path.with_suffix(".part")
            partial.write_bytes(pickle.dumps(_room(split, i, views, config, executor)))
            partial.replace(path)
            print(f"{path.stem}: made", flush=True)
        room: ScannedRoom = pickle.loads(path.read_bytes())
        yield room


def _key(config: Config, views: int) -> str:
    """Changes with settings and weights, and with the code that makes rooms and features."""
    package = weights.FOLDER.parent
    made_by = [*weights.FOLDER.glob("*.safetensors")]
    made_by += [p for part in ("synthetic", "completion") for p in (package / part).rglob("*.py")]
    digest = hashlib.sha256(repr((config.hash(), views)).encode())
    for path in sorted(made_by):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:12]


def _room(split: Split, index: int, views: int, config: Config, executor: Executor) -> ScannedRoom:
    mode = "spread" if index % 2 else "random"
    seed = synthetic.split_seed(split, FIRST_ROOM[split] + index)
    scene = synthetic.generate(seed, views, index, mode)
    frames = scene.frames
    scans = list(
        executor.map(lambda i: complete(str(i), frames[i], 0, config.features, i), range(views))
    )
    pairs = executor.map(_Pairing(scans, scene, config), itertools.combinations(range(views), 2))
    return ScannedRoom(f"{split}-{index:03d}", tuple(map(_slim, scans)), tuple(pairs))


class _Pairing:
    """Makes pairs of the scans of one scene."""

    def __init__(self, scans: list[CompletedScan], scene: SyntheticScene, config: Config) -> None:
        self.scans = scans
        self.world_T_scan = np.array([scene.poses[name] for name in scene.names])
        self.overlap = overlap_matrix(map(_cloud, scene.frames), self.world_T_scan)
        self.heights = [height_profile(scan) for scan in scans]
        self.limit = config.matching.max_correspondences

    def __call__(self, pair: tuple[int, int]) -> ScanPair:
        i, j = pair
        source, target = self.scans[i], self.scans[j]
        seen = [kind.correspond(source, target) for kind in OBSERVED_KINDS]
        predicted = [kind.correspond(source, target) for kind in COMPLETED_KINDS]
        return ScanPair(
            i,
            j,
            se3.inverse(self.world_T_scan[j]) @ self.world_T_scan[i],
            float(self.overlap[i, j]),
            stack(source, target, seen, self.limit),
            stack(source, target, predicted, self.limit, True),
            lift(source, target, self.heights[i], self.heights[j]),
        )


def _cloud(frame: Frame) -> Array:
    """(n, 3) every measured point of a scan."""
    points = backproject(frame.depth, frame.intrinsics)
    return np.asarray(points[frame.depth > 0], dtype=np.float64)


def _slim(scan: CompletedScan) -> CompletedScan:
    """What the local module and the fit of levelled poses need of a scan."""
    panorama = scan.room.panorama
    if panorama is not None:
        nothing = np.zeros((*panorama.depth.shape, 0), np.float32)
        panorama = replace(panorama, semantics=nothing, descriptors=nothing)
    room = CompletedRoom(scan.room.ring, panorama)
    return replace(scan, depth=np.zeros((0, 0), np.float32), room=room, features={})
