"""What the command lines of all tables and figures share."""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmark.catalogue import MULTI_METHODS, PAIR_METHODS, Method
from benchmark.datasets import SPECS, Dataset, open_dataset
from benchmark.pairs import PairList, load_or_draw
from benchmark.run import run
from benchmark.scoring import pair_row
from benchmark.store import Store
from benchmark.tasks import PairTask

Json = dict[str, Any]
PAIRS, QUICK_PAIRS = 1000, 120
"""Pairs of a table: the paper's thousand, and when it has to be quick."""


def parser(description: str | None, out: str) -> argparse.ArgumentParser:
    """Options that every table has; ``out`` is the default name under ``results``."""
    made = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    made.add_argument("--dataset", default="rooms", metavar="DATA", help=SPECS)
    made.add_argument("--rooms", type=int, help="how many generated rooms")
    made.add_argument("--quick", action="store_true", help="minutes on two cores")
    made.add_argument("--seed", type=int, default=0, help="of the pairs or sets drawn")
    made.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)), help="processes")
    made.add_argument("--cache", type=Path, default=Path("results/cache"), help="kept answers")
    made.add_argument(
        "--out", type=Path, help=f"JSON, default results/{out}-DATA.json; .md and .tex beside it"
    )
    made.set_defaults(table=out)
    return made


def pair_parser(description: str | None, out: str) -> argparse.ArgumentParser:
    """`parser` with the options of tables over pairs."""
    made = parser(description, out)
    made.add_argument("--count", type=int, help=f"pairs, {PAIRS} or with --quick {QUICK_PAIRS}")
    made.add_argument(
        "--pairs", type=Path, help="list of pairs, drawn when it does not exist; has a default"
    )
    return made


def opened(options: argparse.Namespace) -> Dataset:
    """The data set that was asked for."""
    return open_dataset(
        options.dataset, quick=options.quick, cache=options.cache, count=options.rooms
    )


def out_path(options: argparse.Namespace, dataset: Dataset) -> Path:
    """Where the JSON goes."""
    out: Path = options.out or Path("results") / f"{options.table}-{dataset.name}.json"
    return out


def pair_list(options: argparse.Namespace, dataset: Dataset) -> PairList:
    """The pairs that all methods are asked about, kept in a file with their seed."""
    count = options.count or (QUICK_PAIRS if options.quick else PAIRS)
    named = f"{dataset.name}-{count}-seed{options.seed}.json"
    path = options.pairs or options.cache / "pairs" / named
    return load_or_draw(path, dataset, count, options.seed, options.cache)


def settings(options: argparse.Namespace, dataset: Dataset) -> Json:
    """What was asked for, for the results file."""
    return {
        "dataset": dataset.name,
        "scenes": {scene.name: scene.fingerprint for scene in dataset.scenes},
        "seed": options.seed,
        "quick": options.quick,
    }


def answered_pairs(
    options: argparse.Namespace, dataset: Dataset, pairs: PairList, methods: Sequence[Method]
) -> dict[str, list[Json]]:
    """Scored rows of every method on every pair by method key, after running what is missing."""
    store, scenes = Store(options.cache / "answers"), {s.name: s for s in dataset.scenes}
    tasks = {
        method.key: [
            PairTask(store, method, scenes[pair.scene], pair.source, pair.target)
            for pair in pairs.pairs
        ]
        for method in methods
    }
    run([task for of_method in tasks.values() for task in of_method], options.jobs, "pairs")
    return {
        key: [pair_row(task, pair) for task, pair in zip(own, pairs.pairs, strict=True)]
        for key, own in tasks.items()
    }


def method_names(text: str) -> tuple[str, ...]:
    """Comma-separated keys of `PAIR_METHODS`, for argparse."""
    return _known(text, PAIR_METHODS)


def multi_names(text: str) -> tuple[str, ...]:
    """Comma-separated keys of `MULTI_METHODS`, for argparse."""
    return _known(text, MULTI_METHODS)


def _known(text: str, methods: Mapping[str, object]) -> tuple[str, ...]:
    chosen = tuple(text.split(","))
    if unknown := sorted(set(chosen) - methods.keys()):
        raise argparse.ArgumentTypeError(
            f"unknown method {unknown[0]}; there are {', '.join(methods)}"
        )
    return chosen
