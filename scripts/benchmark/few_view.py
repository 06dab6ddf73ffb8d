"""The few-view table: sets of scans, scores of every method on them, text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmark.catalogue import MULTI_METHODS
from benchmark.datasets import Dataset
from benchmark.mesh_runs import MeshTask
from benchmark.run import run
from benchmark.scenes import Scene
from benchmark.scoring import set_row, summarise_sets
from benchmark.sets import (
    KINDS,
    QUICK_COUNT,
    SPARSE_COUNT,
    FrameSet,
    frame_sets,
    largest_overlaps,
    random_counts,
)
from benchmark.store import Record
from benchmark.table import Table
from benchmark.tasks import SetTask
from fewview.evaluation.mesh import MeshErrors
from fewview.evaluation.overlap import CLASSES

Json = dict[str, Any]
KINDS_NOTE = f"which sets: {', '.join(KINDS)}"
ERRORS_NOTE = (
    "Cells: mean rotation error in degrees / mean translation error in metres of all scans after "
    "one gauge alignment (share of scans within 15 degrees and 0.3 m). Scans without a pose "
    "count as identity. Fine2C also uses the scan order."
)
LEFT_NOTE = (
    "Cells: unplaced scans / scans in the largest group that agrees / wrong scans with a stated "
    "probability above 0.5 / sets in which the method broke down, of all scans; CPU seconds a set."
)
OVERLAP_NOTE = (
    "Cells: share of scans within 15 degrees and 0.3 m, by the largest true overlap of a scan with "
    "another of its set; number of scans."
)
MESH_NOTE = (
    "Accuracy / completeness at 5 cm against the true surface of the whole room, same fusion for "
    "all; scans outside the largest component are not fused."
)
TRUE_POSES = "truth"
PAPER = {
    "Fine2C, paper on ScanNet": ("96.5 / 1.41", "62.4 / 0.93", "69.6 / 1.57", "68.6 / 1.43"),
    "RobustRec, paper on ScanNet": ("33.1 / 0.78", "25.1 / 0.52", "16.5 / 0.33", "12.3 / 0.26"),
    "Ours top-5, paper on ScanNet": ("5.13 / 0.18", "2.73 / 0.12", "2.13 / 0.10", "1.81 / 0.09"),
}
QUICK_SCENES = 2
PAPER_SIZES = (5, 10, 15, 20)


def sets_of(
    dataset: Dataset, kinds: Sequence[str], quick: bool, seed: int, cache: Path
) -> list[tuple[Scene, FrameSet]]:
    """All sets of a data set with their scenes; those of `QUICK_SCENES` when it has to be quick."""
    limit = QUICK_COUNT if quick or len(dataset.scenes) > 1 else SPARSE_COUNT
    counts = random_counts(dataset, quick)
    return [
        (scene, one)
        for scene in dataset.scenes[: QUICK_SCENES if quick else None]
        for kind in kinds
        for one in frame_sets(scene, kind, counts=counts, limit=limit, seed=seed, cache=cache)
    ]


def mesh_results(tasks: Mapping[str, Sequence[SetTask]], jobs: int) -> Json:
    """Accuracy and completeness of fused meshes by method and size, where the truth is known.

    The method ``truth`` fuses with the true poses: what nobody can be better than.
    """
    known = {n: [t for t in own if t.scene.has_mesh] for n, own in tasks.items()}
    made = {name: [MeshTask(task) for task in own] for name, own in known.items()}
    made[TRUE_POSES] = [MeshTask(task, True) for task in next(iter(known.values()), [])]
    run([task for own in made.values() for task in own], jobs, "meshes")
    summary = []
    for name, own in made.items():
        sizes = sorted({len(task.placed.names) for task in own})
        for size in sizes:
            records: list[Record[MeshErrors]] = [
                task.store.read(task.path) for task in own if len(task.placed.names) == size
            ]
            summary.append({"method": name, "size": size, **_mesh_means(records)})
    return {"meshes": summary}


def _mesh_means(records: Sequence[Record[MeshErrors]]) -> Json:
    """Means over sets; a set without a mesh counts as neither accurate nor complete."""
    found = [record.answer for record in records if record.answer is not None]
    return {
        "sets": len(records),
        "without": len(records) - len(found),
        "accuracy": sum(errors.accuracy for errors in found) / len(records),
        "completeness": sum(errors.completeness for errors in found) / len(records),
        "f_score": sum(errors.f_score for errors in found) / len(records),
    }


def mesh_table(results: Json, where: str) -> Table:
    """Accuracy / completeness, a column a size."""
    groups = results["meshes"]
    sizes = sorted({g["size"] for g in groups})
    rows = []
    for method in dict.fromkeys(g["method"] for g in groups):
        own = {g["size"]: g for g in groups if g["method"] == method}
        label = "true poses" if method == TRUE_POSES else MULTI_METHODS[method].label
        cells = [f"{own[n]['accuracy']:.2f} / {own[n]['completeness']:.2f}" for n in sizes]
        rows.append([label, *cells])
    head = ["method", *(f"{size} scans" for size in sizes)]
    return Table(f"Meshes, {where}", MESH_NOTE, head, rows)


def results_of(
    tasks: Mapping[str, Sequence[SetTask]], sets: Sequence[tuple[Scene, FrameSet]], cache: Path
) -> Json:
    """Rows of every method and set, and their means by kind and size."""
    overlaps = [largest_overlaps(scene, one.names, cache) for scene, one in sets]
    rows = [
        {"method": name, "kind": one.kind, "set": one.id, **set_row(task, largest)}
        for name, own in tasks.items()
        for task, (_, one), largest in zip(own, sets, overlaps, strict=True)
    ]
    groups = dict.fromkeys((row["method"], row["kind"], row["size"]) for row in rows)
    summary = [
        {"method": method, "kind": kind, "size": size}
        | summarise_sets(
            [r for r in rows if (r["method"], r["kind"], r["size"]) == (method, kind, size)]
        )
        for method, kind, size in groups
    ]
    keys = {name: own[0].method.key for name, own in tasks.items() if own}
    return {"methods": keys, "summary": summary, "rows": rows}


def tables_of(results: Json, where: str) -> list[Table]:
    """Errors, and what was left out, a column a size; and what is right by overlap, a column a
    class; for each kind of sets."""
    tables = []
    for kind in dict.fromkeys(group["kind"] for group in results["summary"]):
        groups = [g for g in results["summary"] if g["kind"] == kind]
        sizes = sorted({g["size"]: g["sets"] for g in groups}.items())
        head = ["method", *(f"{size} scans ({count} sets)" for size, count in sizes)]
        errors, left = [], []
        for method in dict.fromkeys(g["method"] for g in groups):
            own = {g["size"]: g for g in groups if g["method"] == method}
            label = MULTI_METHODS[method].label
            errors.append([label, *(_errors(own[size]) for size, _ in sizes)])
            left.append([label, *(_left(own[size]) for size, _ in sizes)])
        if [size for size, _ in sizes] == list(PAPER_SIZES):
            errors += [[label, *cells] for label, cells in PAPER.items()]
        tables.append(Table(f"{kind} sets, {where}", ERRORS_NOTE, head, errors))
        tables.append(Table(f"{kind} sets, {where}: what was left out", LEFT_NOTE, head, left))
        tables.append(_overlap_table(groups, f"{kind} sets, {where}: by overlap"))
    return tables


def _overlap_table(groups: Sequence[Json], title: str) -> Table:
    """What is right of the scans of a class, a column a class and a row a size and method."""
    classes = [name for _, name in CLASSES]
    lines = []
    for group in sorted(groups, key=lambda group: group["size"]):
        own = group["by_overlap"]
        cells = [f"{own[c]['right']:.2f}; {own[c]['scans']}" if c in own else "" for c in classes]
        lines.append([f"{group['size']} scans, {MULTI_METHODS[group['method']].label}", *cells])
    return Table(title, OVERLAP_NOTE, ["", *classes], lines)


def _errors(group: Json) -> str:
    errors = f"{group['rotation_deg']:.1f} / {group['translation_m']:.3f}"
    return f"{errors} ({group['right']:.2f})"


def _left(group: Json) -> str:
    counts = (group["unplaced"], group["agreeing"], group["wrong_and_sure"], group["broken"])
    return f"{' / '.join(map(str, counts))} of {group['scans']}; {group['cpu_seconds']:.0f} s"
