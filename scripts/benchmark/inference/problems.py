"""Discrete problems with known poses: planted, read from files, or from the yardstick's pairs."""

from __future__ import annotations

import argparse
import pickle
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.catalogue import MULTI_METHODS
from benchmark.command import opened
from benchmark.few_view import sets_of
from benchmark.planted_graphs import planted_graph
from benchmark.run import run
from benchmark.store import Store
from benchmark.tasks import SetTask
from fewview.config import GlobalConfig
from fewview.global_stage.model import Problem, build
from fewview.types import Array, PairResult

SIZES = (5, 10, 15, 20)
TOP_K = 5
REPEATS, QUICK_REPEATS = 2, 1
FIRST_SEED = 100
"""Graphs of smaller seeds were looked at while the search was written."""
DIFFICULTIES: Mapping[str, Mapping[str, Any]] = {
    "many links": {"link_rate": 0.5, "strength": (0.2, 0.9)},
    "few links": {"link_rate": 0.3, "strength": (0.3, 0.9)},
    "look-alikes": {"link_rate": 0.4, "strength": (0.3, 0.9), "lookalike": 0.7},
    "weak links": {"link_rate": 0.6, "strength": (0.1, 0.5)},
}
"""Arguments of `planted_graph`."""
POOLED = "pooled"
"""All scans of a file's several sets as one problem, without the pairs that no set has."""


@dataclass(frozen=True)
class Posed:
    """A problem with the truth.

    Attributes:
        group: what it is averaged with.
        problem: the candidates.
        truth: (n, 4, 4) world_T_scan.
    """

    group: str
    problem: Problem
    truth: Array


def planted(config: GlobalConfig, quick: bool) -> Iterator[Posed]:
    """Problems of every size and difficulty."""
    repeats = QUICK_REPEATS if quick else REPEATS
    for size in SIZES:
        for name, arguments in DIFFICULTIES.items():
            for seed in range(FIRST_SEED, FIRST_SEED + repeats):
                truth, pairs = planted_graph(seed, size, TOP_K, **arguments)
                yield Posed(f"{name}, {size} scans", build(size, pairs, config), truth)


def filed(folder: Path, config: GlobalConfig) -> Iterator[Posed]:
    """Problems of a folder of pickled rooms.

    Each ``*.pkl`` is a dict: ``poses`` (n, 4, 4) world_T_scan, ``sets`` a list of (kind, scan
    indices), ``pairs`` {(i, j): PairResult} by scan indices. Read only files of your own making:
    a pickle can run code.

    Raises:
        SystemExit: there is no such file.
    """
    paths = sorted(folder.glob("*.pkl"))
    if not paths:
        raise SystemExit(f"{folder} holds no problems: give a folder of *.pkl files")
    for path in paths:
        room = pickle.loads(path.read_bytes())
        everyone = sorted({scan for _, scans in room["sets"] for scan in scans})
        pooled = [(POOLED, everyone)] if len(room["sets"]) > 1 else []
        for kind, scans in [*room["sets"], *pooled]:
            pairs = numbered(scans, room["pairs"])
            size = f"{len(scans)} scans" if kind != POOLED else "all scans of a room"
            problem = build(len(scans), pairs, config)
            yield Posed(f"rooms, {kind}, {size}", problem, room["poses"][scans])


def answered(options: argparse.Namespace, config: GlobalConfig) -> Iterator[Posed]:
    """Problems of a data set's sets; their pairs are answered first where they are not yet."""
    dataset = opened(options)
    store = Store(options.cache / "answers")
    sets = sets_of(dataset, options.sets, options.quick, options.seed, options.cache)
    tasks = [SetTask(store, MULTI_METHODS["ours_top5"], scene, s.names) for scene, s in sets]
    run([task.turns for task in tasks], options.jobs, "orientation")
    run([pair for task in tasks for pair in task.pairs().values()], options.jobs, "pairs")
    for task, (scene, chosen) in zip(tasks, sets, strict=True):
        answers = {pair: one.answer().detail for pair, one in task.pairs().items()}
        results = {pair: detail.result for pair, detail in answers.items() if detail is not None}
        size = len(task.names)
        problem = build(size, numbered(range(size), results), config)
        truth = np.stack([scene.truth[name] for name in task.names])
        yield Posed(f"{dataset.name}, {chosen.kind}, {size} scans", problem, truth)


def numbered(
    scans: Sequence[int], results: Mapping[tuple[int, int], PairResult]
) -> list[PairResult]:
    """The results between some of the scans, in their numbers."""
    number = {scan: i for i, scan in enumerate(scans)}
    return [
        replace(result, source=number[i], target=number[j])
        for (i, j), result in results.items()
        if i in number and j in number
    ]
