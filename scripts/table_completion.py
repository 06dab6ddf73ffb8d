"""Completed rooms against the truth: 360-image, 2D layout, planes, descriptors, speed.

    python scripts/table_completion.py --quick --beside DATA/headset-office DATA/headset-meeting
    python scripts/table_completion.py --networks results/train_panorama results/train_layout

Generated rooms are the networks' own test split; real rooms need a true mesh, `truth.ply`.
Baselines know 300 training rooms (60 with --quick). Answers are kept: a second run counts them
again, a run that was killed goes on where it was.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from benchmark.command import parser
from benchmark.completion_networks import Networks, add_networks
from benchmark.completion_runs import CompletionTask, TypicalTask
from benchmark.completion_scores import total
from benchmark.completion_speed import SpeedTask
from benchmark.completion_tables import summarise, tables
from benchmark.completion_views import GeneratedRoom, ViewSource, groups_of
from benchmark.datasets import SPLITS, open_dataset
from benchmark.run import run
from benchmark.store import Store
from benchmark.table import write

ROOMS, VIEWS = (40, 6), (8, 4)
"""Generated rooms and views of each, in full and when it has to be quick."""
TYPICAL_ROOMS, TYPICAL_VIEWS = (300, 60), 2
"""Rooms of the training split that baselines know, likewise, and views of each."""
GROUP = 4
"""Frames of a real room whose descriptors are compared with each other."""


def main() -> None:
    """Parse the arguments, complete what is missing, print the tables."""
    options = _options()
    store, networks = Store(options.cache / "answers"), Networks.found(options.networks)
    train = range(TYPICAL_ROOMS[options.quick])
    known = [GeneratedRoom("train", i, TYPICAL_VIEWS, options.library) for i in train]
    usual = TypicalTask(store, tuple(known))
    speed = SpeedTask(store, networks)
    sets = {
        name: [CompletionTask(store, room, networks, usual, options.seed) for room in rooms]
        for spec in (options.dataset, *options.beside)
        for name, rooms in _rooms(spec, options).items()
    }
    run([usual], 1, "training rooms")
    run([task for tasks in sets.values() for task in tasks], options.jobs, "completion")
    run([speed], 1, "speed")
    summaries = {name: summarise(total(t.counts() for t in tasks)) for name, tasks in sets.items()}
    milliseconds = speed.milliseconds()
    results: dict[str, Any] = {
        "rooms": {name: [task.source.key for task in tasks] for name, tasks in sets.items()},
        "seed": options.seed,
        "quick": options.quick,
        "training_rooms": len(usual.rooms),
        "library": None if options.library is None else str(options.library),
        "networks": networks.cards(),
        "figures": summaries,
        "speed_ms": milliseconds,
    }
    out = options.out or Path("results") / f"{options.table}-{next(iter(sets))}.json"
    print(write(out, results, tables(summaries, milliseconds)))


def _options() -> argparse.Namespace:
    made = parser(__doc__, "completion")
    made.add_argument("--beside", nargs="+", default=[], metavar="DATA", help="further data sets")
    made.add_argument(
        "--library", type=Path, metavar="DIR", help="furniture models in generated rooms"
    )
    add_networks(made)
    return made.parse_args()


def _rooms(spec: str, options: argparse.Namespace) -> dict[str, list[ViewSource]]:
    """The rooms of a data set by the name of their set."""
    if spec in SPLITS:
        split, views = SPLITS[spec], VIEWS[options.quick]
        made = range(ROOMS[options.quick])
        rooms = [GeneratedRoom(split, index, views, options.library) for index in made]
        return {f"rooms-{split}": [*rooms]}
    scenes = open_dataset(spec, quick=options.quick, cache=options.cache).scenes
    return {scene.name: [*groups_of(scene, GROUP, options.seed)] for scene in scenes}


if __name__ == "__main__":
    main()
