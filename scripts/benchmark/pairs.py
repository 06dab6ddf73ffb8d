"""Lists of scan pairs, kept in files so that every method is asked about the same ones."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from benchmark.datasets import Dataset
from benchmark.scenes import Scene
from fewview.evaluation.overlap import CLASSES, overlap_class

YAW_BIN_DEG = 30
FORMAT = 1


@dataclass(frozen=True)
class Pair:
    """Two scans of a scene.

    Attributes:
        scene: its name.
        source: name of the scan that is to be moved.
        target: name of the scan it is to be moved to.
        overlap: true, 0..1.
        yaw_deg: true angle between the viewing directions seen from above, 0..180.
        centroid: of the source's measured points in its own frame, metres.
    """

    scene: str
    source: str
    target: str
    overlap: float
    yaw_deg: float
    centroid: tuple[float, float, float]


@dataclass(frozen=True)
class PairList:
    """Pairs of a data set.

    Attributes:
        dataset: its name.
        seed: that the pairs were drawn with.
        count: how many were asked for.
        fingerprints: of the scenes that the pairs are of, by name.
        pairs: scene by scene.
    """

    dataset: str
    seed: int
    count: int
    fingerprints: dict[str, str]
    pairs: tuple[Pair, ...]

    def write(self, path: Path) -> None:
        """Write as JSON; the file appears complete or not at all."""
        content = {"format": FORMAT, **asdict(self)}
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f".{path.name}.partial")
        partial.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n")
        partial.replace(path)

    @staticmethod
    def read(path: Path) -> PairList:
        """Read what `write` wrote.

        Raises:
            SystemExit: it is something else.
        """
        try:
            content = json.loads(path.read_text())
            if content.pop("format") != FORMAT:
                raise ValueError
            pairs = tuple(
                Pair(**pair | {"centroid": tuple(pair["centroid"])})
                for pair in content.pop("pairs")
            )
            return PairList(**content, pairs=pairs)
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise SystemExit(f"{path} is not a list of pairs: remove it to draw anew") from error


def draw(dataset: Dataset, count: int, seed: int, cache: Path) -> PairList:
    """Draw ``count`` random pairs spread evenly over the scenes, none of them twice.

    Scenes that have fewer pairs than their share give all they have.
    """
    shares = [count // len(dataset.scenes)] * len(dataset.scenes)
    for i in range(count % len(shares)):
        shares[i] += 1
    pairs: list[Pair] = []
    scenes = tqdm(dataset.scenes, desc="overlaps", unit="scene", leave=False)
    for i, (scene, share) in enumerate(zip(scenes, shares, strict=True)):
        pairs += _of_scene(scene, share, np.random.default_rng([seed, i]), seed, cache)
    return PairList(dataset.name, seed, count, _fingerprints(dataset), tuple(pairs))


def load_or_draw(path: Path, dataset: Dataset, count: int, seed: int, cache: Path) -> PairList:
    """The list of a file, which is drawn and written first when it does not exist.

    Raises:
        SystemExit: the list was drawn with other numbers or of other data.
    """
    if not path.is_file():
        draw(dataset, count, seed, cache).write(path)
    kept = PairList.read(path)
    asked = (dataset.name, seed, count)
    if (kept.dataset, kept.seed, kept.count) != asked:
        raise SystemExit(
            f"{path} holds {kept.count} pairs of {kept.dataset} drawn with seed {kept.seed}, not "
            f"{count} of {dataset.name} with seed {seed}: give another file, or remove it"
        )
    now = _fingerprints(dataset)
    changed = sorted(n for n in now | kept.fingerprints if now.get(n) != kept.fingerprints.get(n))
    if changed:
        raise SystemExit(
            f"{path} was drawn from other data ({', '.join(changed[:3])} and so on, "
            f"{len(changed)} scenes differ): bring them back, or remove the file"
        )
    return kept


def difficulty(pairs: Sequence[Pair]) -> dict[str, Any]:
    """How hard pairs are: their number, shares of the overlap classes and of bins of yaw."""
    overlaps = Counter(overlap_class(pair.overlap) for pair in pairs)
    last = 180 // YAW_BIN_DEG - 1
    yaws = Counter(min(int(pair.yaw_deg // YAW_BIN_DEG), last) for pair in pairs)
    total = max(1, len(pairs))
    edges = [(i, f"{i * YAW_BIN_DEG}-{(i + 1) * YAW_BIN_DEG}") for i in range(last + 1)]
    return {
        "pairs": len(pairs),
        "overlap": {name: overlaps[name] / total for _, name in CLASSES},
        "yaw_deg": {name: yaws[i] / total for i, name in edges},
    }


def _of_scene(
    scene: Scene, count: int, rng: np.random.Generator, seed: int, cache: Path
) -> list[Pair]:
    views = scene.limited(seed)
    overlaps = views.overlaps(cache)
    every = list(combinations(range(len(views.names)), 2))
    chosen = rng.choice(len(every), min(count, len(every)), replace=False)
    centroids: dict[str, tuple[float, float, float]] = {}
    found = []
    for a, b in (rng.permutation(every[i]) for i in chosen):
        source, target = views.names[a], views.names[b]
        yaw = scene.yaw_deg(source, target)
        if source not in centroids:
            centroids[source] = tuple(scene.cloud(source).mean(axis=0).tolist())
        shared = float(overlaps[a, b])
        found.append(Pair(scene.name, source, target, shared, yaw, centroids[source]))
    return found


def _fingerprints(dataset: Dataset) -> dict[str, str]:
    return {scene.name: scene.fingerprint for scene in dataset.scenes}
