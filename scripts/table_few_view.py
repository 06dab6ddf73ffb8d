"""Poses of 5, 10, 15, 20 scans: fewview with its top-1, top-3, top-5 candidates, and its peers.

    python scripts/table_few_view.py --dataset rooms --out results/few_view.json
    python scripts/table_few_view.py --dataset DATA/redkitchen --sets random low

Every pair is answered once a scene, whichever sets it is in, and kept; so is every set.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

from benchmark.catalogue import MULTI_METHODS
from benchmark.command import multi_names, opened, out_path, parser, settings
from benchmark.few_view import (
    KINDS_NOTE,
    mesh_results,
    mesh_table,
    results_of,
    sets_of,
    tables_of,
)
from benchmark.scenes import rolled
from benchmark.store import Store
from benchmark.table import write
from benchmark.tasks import SetTask, run_sets


def main() -> None:
    """Parse the arguments, run, print the table."""
    options = arguments()
    dataset = opened(options)
    if options.roll:
        turned = tuple(rolled(scene, options.seed, options.cache) for scene in dataset.scenes)
        dataset = replace(dataset, name=f"{dataset.name}-rolled", scenes=turned)
    store = Store(options.cache / "answers")
    drawn = sets_of(dataset, options.sets, options.quick, options.seed, options.cache)
    sets = [one for one in drawn if not options.sizes or len(one[1].names) in options.sizes]
    tasks = {
        name: [SetTask(store, MULTI_METHODS[name], scene, s.names) for scene, s in sets]
        for name in options.methods
    }
    run_sets([task for own in tasks.values() for task in own], options.jobs)
    results = results_of(tasks, sets, options.cache)
    where = f"{dataset.name}, scenes: {len({s.name for s, _ in sets})}, seed {options.seed}"
    tables = tables_of(results, where)
    if options.mesh:
        results |= mesh_results(tasks, options.jobs)
        tables += [mesh_table(results, where)] if results["meshes"] else []
    print(write(out_path(options, dataset), {**settings(options, dataset), **results}, tables))


def arguments() -> argparse.Namespace:
    """The command line."""
    made = parser(__doc__, "few-view")
    made.add_argument("--sets", nargs="+", default=["random"], help=KINDS_NOTE)
    made.add_argument("--sizes", type=int, nargs="+", help="scans of a set, all sizes by default")
    made.add_argument(
        "--methods",
        type=multi_names,
        default=tuple(MULTI_METHODS),
        help=f"comma-separated, of {', '.join(MULTI_METHODS)}",
    )
    made.add_argument("--mesh", action="store_true", help="also compare meshes, where truth is")
    made.add_argument("--roll", action="store_true", help="half of the images in quarter turns")
    return made.parse_args()


if __name__ == "__main__":
    main()
