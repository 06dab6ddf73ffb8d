"""Accuracies and confusion matrices of relation predictors, with the paper's beside them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmark.pairs import Pair
from benchmark.relation_runs import CEILING, Judged
from benchmark.relations import PREDICTORS
from benchmark.scoring import OVERLAPS, yaw_classes
from benchmark.table import Json, Table
from fewview.evaluation.relations import Relation, accuracies, row_shares
from fewview.types import Array, IntArray

CLASSES = ("none", "co-planar", "parallel", "perpendicular")
"""Of `Relation`, as tables print them."""
PAPER_ACCURACY = (0.46, 0.93, 0.75, 0.69)
"""Sec. 4: mean of three data sets, in the order of `Relation`."""
PAPER_CONFUSION = (
    (0.806, 0.831, 0.034, 0.077),
    (0.667, 0.307, 0.007, 0.019),
    (0.628, 0.065, 0.301, 0.006),
    (0.568, 0.064, 0.054, 0.314),
)
"""Supplementary, "confusion matrix of the prediction module", in the order of `Relation`."""
PAPER_NOTE = (
    "The paper's row of none is as printed; 0.083 instead of 0.831 would make it add up to one. "
    "Its diagonal is not the accuracies of its main text."
)
MAJORITY = "majority class"
"""Not a method: the class with most labels, whatever the points."""
SHOWN = ("rules, 30 deg / 1 m", "planar patches", "relation network")
"""Predictors whose confusion matrix is printed; the JSON has all."""
Group = Callable[[Json], bool]


def groups() -> dict[str, Group]:
    """What results are split by: overlap, size of the perturbation, true relative yaw."""

    def perturbed_by(low: int) -> Group:
        return lambda row: bool(low <= row["perturbation_deg"] < low + 10)

    overlaps = {f"overlap {name}": OVERLAPS[name] for name in (">= 10 %", "< 10 %")}
    turned = {f"perturbed by {low}-{low + 10} deg": perturbed_by(low) for low in (0, 10, 20)}
    yaws = {f"true yaw {name}": fits for name, fits in yaw_classes().items()}
    return {"all": OVERLAPS["all"], **overlaps, **turned, **yaws}


def rows(pairs: Sequence[Pair], judged: Sequence[Sequence[Judged]]) -> list[Json]:
    """One row a pair and perturbed pose."""
    return [
        {
            "overlap": pair.overlap,
            "yaw_deg": pair.yaw_deg,
            "perturbation_deg": one.perturbation_deg,
            "counts": one.counts,
        }
        for pair, several in zip(pairs, judged, strict=True)
        for one in several
    ]


def summarise(rows: Sequence[Json], from_mesh: bool) -> Json:
    """Counts, class shares and accuracies by group and predictor; empty groups are left out.

    Args:
        rows: see `rows`.
        from_mesh: labels come from true meshes; else `CEILING` is left out, because its normals
            are then those of the labels.
    """
    names = [*PREDICTORS, *([CEILING] if from_mesh else [])]
    members = {name: [row for row in rows if fits(row)] for name, fits in groups().items()}
    return {group: _group(found, names) for group, found in members.items() if found}


def tables(summary: Json, where: str) -> list[Table]:
    """Per-class accuracies by group, and confusion matrices.

    Args:
        summary: of `summarise`.
        where: data set and labels, for the titles.
    """
    return [_accuracy_table(summary, where), _confusion_table(summary["all"], where)]


def reference() -> Json:
    """The paper's numbers."""
    return {"accuracy": _named(PAPER_ACCURACY), "confusion": PAPER_CONFUSION, "note": PAPER_NOTE}


def _group(rows: Sequence[Json], names: Sequence[str]) -> Json:
    counts = {name: sum(row["counts"][name] for row in rows) for name in names}
    labels = counts[names[0]].sum(axis=1)
    counts[MAJORITY] = np.outer(labels, np.arange(len(labels)) == labels.argmax()).astype(int)
    return {
        "poses": len(rows),
        "shares": _named(labels / labels.sum()),
        "predictors": {name: _scores(counts[name]) for name in (MAJORITY, *names)},
    }


def _scores(counts: IntArray) -> Json:
    right = accuracies(counts)
    return {
        "accuracy": _named(right),
        "mean": None if np.isnan(right).all() else float(np.nanmean(right)),
        "counts": counts.tolist(),
    }


def _named(values: Array | Sequence[float]) -> dict[str, float | None]:
    """Class names to values; NaN becomes None."""
    found = zip(CLASSES, values, strict=True)
    return {name: None if np.isnan(value) else float(value) for name, value in found}


def _accuracy_table(summary: Json, where: str) -> Table:
    lines: list[list[str]] = []
    for name, group in summary.items():
        shares = ", ".join(f"{c} {s:.0%}" for c, s in group["shares"].items())
        lines.append([f"{name} ({group['poses']} poses; {shares})"])
        for predictor in (MAJORITY, *PREDICTORS, CEILING):
            lines += _accuracy_line(predictor, group["predictors"])
        if name == "all":
            mean = float(np.mean(PAPER_ACCURACY))
            lines.append(["the paper, on its data", *map(_cell, (*PAPER_ACCURACY, mean))])
    note = (
        "Share of a class's point pairs that are predicted right, under true poses perturbed by "
        "up to 30 deg and 0.5 m an axis; mean: of the four classes. The row with the true pose is "
        "not a method: it is what the noise of measured normals costs where labels have none."
    )
    return Table(f"Geometric relations, {where}", note, ["predictor", *CLASSES, "mean"], lines)


def _accuracy_line(name: str, found: Mapping[str, Any]) -> list[list[str]]:
    if name not in found:
        return []
    scores = found[name]
    return [[name, *map(_cell, (*scores["accuracy"].values(), scores["mean"]))]]


def _confusion_table(group: Json, where: str) -> Table:
    lines: list[list[str]] = []
    for name in SHOWN:
        lines += _matrix(name, row_shares(np.array(group["predictors"][name]["counts"])))
    lines += _matrix("the paper", np.array(PAPER_CONFUSION))
    note = f"Rows: the label; columns: the prediction, shares of the row. {PAPER_NOTE}"
    return Table(f"Confusion matrices, {where}", note, ["label", *CLASSES], lines)


def _matrix(title: str, shares: Array) -> list[list[str]]:
    body = [
        [CLASSES[relation], *(f"{value:.3f}" for value in shares[relation])]
        for relation in Relation
        if not np.isnan(shares[relation]).any()
    ]
    return [[title], *body]


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
