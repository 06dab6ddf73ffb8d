"""The frame sets of the few-view protocol; drawn with a fixed seed or read from the scene."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fewview.evaluation.overlap import overlap_matrix
from fewview.types import Array
from scenes import Scene

RANDOM_COUNTS = {5: 6, 10: 6, 15: 2, 20: 2}
"""Random sets: scans in a set -> number of sets."""
QUICK_COUNTS = {5: 2, 10: 1}
LOW_COUNT, LOW_SIZE, LOW_OVERLAP = 8, 5, 0.5
"""Low-overlap sets: how many, of how many scans, and the overlap no pair may exceed."""
WIDE = {"studyroom": (0, 116, 422, 935, 984, 3160, 3209)}
"""Really different views, picked by hand."""


@dataclass(frozen=True)
class FrameSet:
    """Scans that a method is given together."""

    kind: str
    index: int
    names: tuple[str, ...]

    @property
    def id(self) -> str:
        """A name for files: kind, number of scans, index."""
        return f"{self.kind}-{len(self.names):02d}-{self.index}"


def frame_sets(scene: Scene, kind: str, *, seed: int, quick: bool, cache: Path) -> list[FrameSet]:
    """All sets of one kind: random, low, wide, or what a file ``sets-KIND.txt`` lists."""
    listed = scene.folder / f"sets-{kind}.txt"
    if listed.is_file():
        drawn = [_by_number(scene, line.split()) for line in listed.read_text().splitlines()]
    elif kind == "random":
        drawn = _random(scene, QUICK_COUNTS if quick else RANDOM_COUNTS, seed)
    elif kind == "low":
        drawn = _low(scene, overlaps(scene, cache), seed)
    elif kind == "wide" and scene.name in WIDE:
        drawn = [_by_number(scene, WIDE[scene.name])]
    else:
        raise SystemExit(f"{scene.folder}: has no {kind} sets")
    if quick and kind != "random":
        drawn = drawn[:2]
    seen: Counter[int] = Counter()
    found = []
    for names in drawn:
        found.append(FrameSet(kind, seen[len(names)], names))
        seen[len(names)] += 1
    return found


def overlaps(scene: Scene, cache: Path) -> Array:
    """The (n, n) true overlaps of all frames of a scene, kept in ``cache``."""
    path = cache / scene.name / "overlap.npz"
    if path.is_file():
        stored = np.load(path)
        if stored["names"].tolist() == list(scene.names):
            return np.asarray(stored["overlap"])
    clouds = (scene.cloud(name) for name in scene.names)
    matrix = overlap_matrix(clouds, np.stack([scene.truth[name] for name in scene.names]))
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, names=np.array(scene.names), overlap=matrix)
    return matrix


def overlaps_by_name(
    scene: Scene, names: tuple[str, ...], cache: Path
) -> dict[tuple[str, str], float]:
    """True overlap of every pair of a set."""
    matrix, row = overlaps(scene, cache), {name: i for i, name in enumerate(scene.names)}
    return {(a, b): float(matrix[row[a], row[b]]) for a in names for b in names if a < b}


def half_turned(chosen: FrameSet, seed: int) -> dict[str, int]:
    """Quarter turns for half of a set: each of the chosen scans by 90, 180 or 270 degrees."""
    rng = np.random.default_rng([seed, len(chosen.names), chosen.index])
    half = rng.permutation(len(chosen.names))[: len(chosen.names) // 2]
    return {chosen.names[i]: int(rng.integers(1, 4)) for i in half}


def _by_number(scene: Scene, numbers: tuple[int, ...] | list[str]) -> tuple[str, ...]:
    by_number = {int(name.split("-")[-1]): name for name in scene.names}
    return tuple(sorted(by_number[int(number)] for number in numbers))


def _random(scene: Scene, counts: dict[int, int], seed: int) -> list[tuple[str, ...]]:
    drawn = []
    for size, count in counts.items():
        rng = np.random.default_rng([seed, size])
        for _ in range(count if size <= len(scene.names) else 0):
            chosen = rng.choice(len(scene.names), size=size, replace=False)
            drawn.append(tuple(scene.names[i] for i in np.sort(chosen)))
    return drawn


def _low(scene: Scene, matrix: Array, seed: int) -> list[tuple[str, ...]]:
    """Sets without a pair above `LOW_OVERLAP`; frames join in random order while they fit."""
    rng = np.random.default_rng([seed, LOW_SIZE, 1])
    drawn: list[tuple[str, ...]] = []
    for _ in range(100 * LOW_COUNT):
        chosen: list[int] = []
        for i in rng.permutation(len(scene.names)):
            if len(chosen) < LOW_SIZE and np.all(matrix[i, chosen] <= LOW_OVERLAP):
                chosen.append(int(i))
        names = tuple(scene.names[i] for i in sorted(chosen))
        if len(chosen) == LOW_SIZE and names not in drawn:
            drawn.append(names)
        if len(drawn) == LOW_COUNT:
            break
    return drawn
