"""The local module beside ICP, generalised ICP and SparseICP from perturbed true poses.

    python scripts/table_refinement.py --dataset rooms --quick

Answers are kept: a second run scores them again, a run that was killed goes on where it was.
"""

from __future__ import annotations

from benchmark.catalogue import LOCAL_LABELS
from benchmark.command import opened, out_path, pair_list, pair_parser, settings
from benchmark.pairs import difficulty
from benchmark.refinement_runs import FARTHEST, START, STARTS, Outcome, RefinementTask
from benchmark.refinement_tables import rows, summarise, table
from benchmark.run import run
from benchmark.store import Record, Store
from benchmark.table import write


def main() -> None:
    """Parse the arguments, refine what is missing, print the table."""
    options = pair_parser(__doc__, "refinement").parse_args()
    dataset = opened(options)
    pairs = pair_list(options, dataset).pairs
    store, scenes = Store(options.cache / "answers"), {s.name: s for s in dataset.scenes}
    names = tuple(LOCAL_LABELS)
    tasks = [
        RefinementTask(store, scenes[p.scene], p.source, p.target, options.seed, names)
        for p in pairs
    ]
    run(tasks, options.jobs, "refinement")
    records: list[Record[Outcome]] = [store.read(task.path) for task in tasks]
    summary = summarise(rows(pairs, records), names)
    results = {
        **settings(options, dataset),
        "starts": STARTS,
        "farthest_deg_m": FARTHEST,
        "difficulty": difficulty(pairs),
        "pairs_left_out": sum(record.answer is None for record in records),
        "groups": summary,
    }
    title = f"Local refinement from perturbed truth, {dataset.name}, {len(pairs)} pairs"
    labels = {START: "where they start", **LOCAL_LABELS}
    print(write(out_path(options, dataset), results, [table(title, labels, summary)]))


if __name__ == "__main__":
    main()
