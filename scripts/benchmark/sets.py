"""Sets of frames for the few-view protocol; drawn with a fixed seed or listed by the scene."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmark.datasets import Dataset
from benchmark.scenes import MAX_VIEWS, Scene

KINDS = ("random", "low", "extreme", "wide")
RANDOM_COUNTS = {5: 6, 10: 6, 15: 2, 20: 2}
"""Random sets of a scene given alone: scans in a set -> number of sets."""
QUICK_COUNTS = {5: 2, 10: 1, 15: 1, 20: 1}
ROOM_COUNTS = {5: 1, 10: 1, 15: 1, 20: 1}
"""Random sets of each scene of a data set of many."""
SPARSE_SIZE, SPARSE_COUNT, QUICK_COUNT = 5, 8, 2
"""Sets of little overlap: scans in a set, sets of a scene, and when it has to be quick."""
BOUNDS = {"low": 0.5, "extreme": 0.1}
"""The overlap that no pair of such a set exceeds."""
WIDE = {"studyroom": (0, 116, 422, 935, 984, 3160, 3209)}
"""Really different views, picked by hand."""


@dataclass(frozen=True)
class FrameSet:
    """Scans that a method is given together.

    Attributes:
        kind: one of `KINDS`.
        index: counts the sets of equal kind and size of a scene.
        names: the scans, in the order of the scene.
    """

    kind: str
    index: int
    names: tuple[str, ...]

    @property
    def id(self) -> str:
        """A name for files: kind, number of scans, index."""
        return f"{self.kind}-{len(self.names):02d}-{self.index}"


def random_counts(dataset: Dataset, quick: bool) -> dict[int, int]:
    """How many random sets of each size a scene of the data set gives."""
    if len(dataset.scenes) > 1:
        return ROOM_COUNTS
    return QUICK_COUNTS if quick else RANDOM_COUNTS


def frame_sets(
    scene: Scene,
    kind: str,
    *,
    counts: Mapping[int, int],
    limit: int,
    seed: int,
    cache: Path,
) -> list[FrameSet]:
    """The sets of one kind.

    A file ``sets-KIND.txt`` of the scene comes first: a line a set, the numbers at the end of the
    frames' names. Random sets of sizes that it lacks are drawn; so are sets of little overlap
    where there is no such file, fewer than ``limit`` or none where the scene has no more.

    Args:
        scene: where the frames are.
        kind: one of `KINDS`.
        counts: random sets to draw: scans in a set -> number of sets.
        limit: sets of the other kinds at most.
        seed: of the drawn sets.
        cache: where overlaps are kept.

    Raises:
        SystemExit: there is no such kind.
    """
    if kind not in KINDS:
        raise SystemExit(f"there are no '{kind}' sets: take {', '.join(KINDS)}")
    drawn = _listed(scene, kind)
    if kind == "random":
        known = {len(names) for names in drawn}
        missing = {size: count for size, count in counts.items() if size not in known}
        drawn += _random(scene, missing, seed)
    elif kind in BOUNDS and not drawn:
        drawn = _sparse(scene.limited(seed), kind, limit, seed, cache)
    return _numbered(kind, drawn if kind == "random" else drawn[:limit])


def overlaps_by_name(
    scene: Scene, names: Sequence[str], cache: Path
) -> dict[tuple[str, str], float]:
    """True overlap of every pair of a set, the smaller name first."""
    views = scene if len(scene.names) <= MAX_VIEWS else replace(scene, only=tuple(names))
    matrix, row = views.overlaps(cache), {name: i for i, name in enumerate(views.names)}
    return {(a, b): float(matrix[row[a], row[b]]) for a in names for b in names if a < b}


def largest_overlaps(scene: Scene, names: Sequence[str], cache: Path) -> dict[str, float]:
    """For each scan of a set its largest true overlap with another of them."""
    pairs = overlaps_by_name(scene, names, cache)
    return {name: max(share for pair, share in pairs.items() if name in pair) for name in names}


def _numbered(kind: str, drawn: Sequence[tuple[str, ...]]) -> list[FrameSet]:
    seen: Counter[int] = Counter()
    found = []
    for names in drawn:
        found.append(FrameSet(kind, seen[len(names)], names))
        seen[len(names)] += 1
    return found


def _listed(scene: Scene, kind: str) -> list[tuple[str, ...]]:
    path = scene.folder / f"sets-{kind}.txt"
    if path.is_file():
        lines = path.read_text().splitlines()
        return [_by_number(scene, [int(n) for n in line.split()]) for line in lines]
    if kind == "wide" and scene.name in WIDE:
        return [_by_number(scene, WIDE[scene.name])]
    return []


def _by_number(scene: Scene, numbers: Sequence[int]) -> tuple[str, ...]:
    by_number = {int(name.split("-")[-1]): name for name in scene.names}
    return tuple(sorted(by_number[number] for number in numbers))


def _random(scene: Scene, counts: Mapping[int, int], seed: int) -> list[tuple[str, ...]]:
    drawn = []
    for size, count in counts.items():
        rng = np.random.default_rng([seed, size])
        for _ in range(count if size <= len(scene.names) else 0):
            chosen = rng.choice(len(scene.names), size=size, replace=False)
            drawn.append(tuple(scene.names[i] for i in np.sort(chosen)))
    return drawn


def _sparse(scene: Scene, kind: str, count: int, seed: int, cache: Path) -> list[tuple[str, ...]]:
    """Sets without a pair above the kind's bound; frames join in random order while they fit."""
    apart = scene.overlaps(cache) <= BOUNDS[kind]
    rng = np.random.default_rng([seed, SPARSE_SIZE, 1 + list(BOUNDS).index(kind)])
    drawn: list[tuple[str, ...]] = []
    for _ in range(100 * SPARSE_COUNT):
        chosen: list[int] = []
        for i in rng.permutation(len(scene.names)):
            if len(chosen) < SPARSE_SIZE and np.all(apart[i, chosen]):
                chosen.append(int(i))
        names = tuple(scene.names[i] for i in sorted(chosen))
        if len(chosen) == SPARSE_SIZE and names not in drawn:
            drawn.append(names)
        if len(drawn) == count:
            break
    return drawn
