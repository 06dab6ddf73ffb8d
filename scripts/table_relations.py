"""Accuracy of predicted geometric relations under random perturbation of the true pose.

    python scripts/table_relations.py --dataset rooms --out results/relations.json

Answers are kept: a second run scores them again, a run that was killed goes on where it was.
"""

from __future__ import annotations

from benchmark.command import opened, out_path, pair_list, pair_parser, settings
from benchmark.pairs import difficulty
from benchmark.relation_runs import PERTURBATIONS, SAMPLES, RelationTask
from benchmark.relation_tables import reference, rows, summarise, tables
from benchmark.run import run
from benchmark.store import Store
from benchmark.table import write


def main() -> None:
    """Parse the arguments, judge what is missing, print the tables."""
    options = pair_parser(__doc__, "relations").parse_args()
    dataset = opened(options)
    pairs = pair_list(options, dataset).pairs
    store, scenes = Store(options.cache / "answers"), {s.name: s for s in dataset.scenes}
    tasks = [RelationTask(store, scenes[p.scene], p.source, p.target, options.seed) for p in pairs]
    run(tasks, options.jobs, "relations")
    judged = [task.judged() for task in tasks]
    if not any(judged):
        raise SystemExit(f"{dataset.spec}: no pair has surfaces on both sides to draw points from")
    from_mesh = all(scene.has_mesh for scene in dataset.scenes)
    labels = "the true mesh" if from_mesh else "measured normals"
    summary = summarise(rows(pairs, judged), from_mesh)
    results = {
        **settings(options, dataset),
        "labels": labels,
        "samples": SAMPLES,
        "perturbations": PERTURBATIONS,
        "difficulty": difficulty(pairs),
        "pairs_left_out": sum(not found for found in judged),
        "groups": summary,
        "paper": reference(),
    }
    where = f"{dataset.name}, {len(pairs)} pairs, labels from {labels}"
    print(write(out_path(options, dataset), results, tables(summary, where)))


if __name__ == "__main__":
    main()
