"""Few-view benchmark: fewview and its peers on the same sets of scans, in one run.

    python scripts/few_view.py --scene DATA/redkitchen --sets random low --out results/few_view.json

Writes the JSON and a Markdown table beside it. Runs that were interrupted go on where they were:
every answer is kept under ``--cache`` and made again only when the method's code has changed.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

from fewview.evaluation import evaluate_report
from peers.catalogue import PEERS
from predictions import Task, predict
from scenes import Scene
from sets import frame_sets, half_turned, overlaps_by_name
from summary import summarise
from tables import markdown

Json = dict[str, Any]
METHODS = ("identity", *PEERS, "fewview")
PEER_TO_BEAT = "xfeat_robustrec"


def main() -> None:
    """Parse the arguments, run what is missing, write the results."""
    arguments = parse()
    tasks = [task for folder in arguments.scene for task in tasks_of(Scene(folder), arguments)]
    rows = run(tasks, arguments.cache)
    settings = {
        "seed": arguments.seed,
        "roll": arguments.roll,
        "jobs": arguments.jobs,
        "fewview_options": arguments.option,
    }
    summary = summarise(rows, PEER_TO_BEAT)
    for row in rows:
        del row["scores"]["pairs"]
    results = {"settings": settings, **summary, "rows": rows}
    table = markdown(settings, summary)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(json.dumps(results, indent=1, allow_nan=False) + "\n")
    arguments.out.with_suffix(".md").write_text(table)
    print(table)


def parse() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scene", type=Path, nargs="+", required=True, help="scene folders")
    parser.add_argument(
        "--sets", nargs="+", default=["random"], help="random, low, wide, extreme (sets-KIND.txt)"
    )
    parser.add_argument("--sizes", type=int, nargs="+", help="only sets of so many scans")
    parser.add_argument(
        "--methods",
        type=_methods,
        default=METHODS,
        help=f"comma-separated, of {', '.join(METHODS)}",
    )
    parser.add_argument("--quick", action="store_true", help="two or three sets of each kind")
    parser.add_argument("--roll", choices=("none", "half"), default="none")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0, help="of the drawn sets")
    parser.add_argument(
        "--option", action="append", default=[], help="passed to fewview, as --option=--no-rrd"
    )
    parser.add_argument("--cache", type=Path, default=Path("results/cache"))
    parser.add_argument("--out", type=Path, required=True)
    return parser.parse_args()


def tasks_of(scene: Scene, arguments: argparse.Namespace) -> list[Task]:
    """Every method on every set of a scene, set by set."""
    chosen = [
        one
        for kind in arguments.sets
        for one in frame_sets(
            scene, kind, seed=arguments.seed, quick=arguments.quick, cache=arguments.cache
        )
        if arguments.sizes is None or len(one.names) in arguments.sizes
    ]
    roll = arguments.roll == "half"
    return [
        Task(
            scene,
            one,
            half_turned(one, arguments.seed) if roll else {},
            method,
            tuple(arguments.option) if method == "fewview" else (),
            arguments.jobs,
        )
        for one in chosen
        for method in arguments.methods
    ]


def run(tasks: list[Task], cache: Path) -> list[Json]:
    """Predict and score every task, telling on stderr how far it is."""
    weights = [0.0 if (cache / task.file).is_file() else _weight(task) for task in tasks]
    start, done, rows = time.monotonic(), 0.0, []
    for i, (task, weight) in enumerate(zip(tasks, weights, strict=True)):
        prediction = predict(task, cache)
        row = score(task, prediction, cache)
        rows.append(row)
        done += weight
        left = (sum(weights) - done) * (time.monotonic() - start) / done if done else 0.0
        where = f"{task.scene.name} {task.chosen.id} {task.method}"
        print(f"[{i + 1}/{len(tasks)}] {where}: {_told(row)}; {left:.0f} s left", file=sys.stderr)
    return rows


def score(task: Task, prediction: Json, cache: Path) -> Json:
    """One row of the results. A run that failed counts as nothing placed, with its last words."""
    report = prediction["report"]
    measured = prediction["measured"]
    failed = report is None
    if failed:
        report = _nothing(task.chosen.names)
    scores = evaluate_report(
        report,
        task.scene.turned_truth(task.chosen.names, task.turns),
        overlaps=overlaps_by_name(task.scene, task.chosen.names, cache),
    )
    return {
        "scene": task.scene.name,
        "kind": task.chosen.kind,
        "size": len(task.chosen.names),
        "set": task.chosen.id,
        "method": task.method,
        "failed": measured["errors"] if failed else None,
        "measured": None
        if measured is None
        else {key: measured[key] for key in ("wall_s", "cpu_s", "peak_mb")},
        "timings_s": report.get("timings_s"),
        "scores": scores,
    }


def _nothing(names: Sequence[str]) -> Json:
    """The report of a method that found no pose at all."""
    unknown: Json = {"selected": None, "candidates": []}
    return {
        "scans": [{"name": name, "placed": False, "component": None} for name in names],
        "pairs": [{"source": a, "target": b, **unknown} for a, b in combinations(names, 2)],
    }


def _weight(task: Task) -> float:
    """Guessed cost of a task: its pairs, and what starting a process takes."""
    n = len(task.chosen.names)
    return 0.0 if task.method == "identity" else 20.0 + n * (n - 1) / 2


def _told(row: Json) -> str:
    if row["failed"] is not None:
        return f"FAILED ({row['failed'].strip().splitlines()[-1:]})"
    total = row["scores"]["absolute"]
    took = f", {row['measured']['wall_s']:.0f} s" if row["measured"] else ""
    return f"{total['rotation_deg']:.1f} deg / {total['translation_m']:.3f} m{took}"


def _methods(text: str) -> tuple[str, ...]:
    chosen = tuple(text.split(","))
    if unknown := set(chosen) - set(METHODS):
        raise argparse.ArgumentTypeError(f"unknown method {', '.join(sorted(unknown))}")
    return chosen


if __name__ == "__main__":
    main()
