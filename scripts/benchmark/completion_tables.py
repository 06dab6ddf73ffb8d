"""Figures of completed rooms beside their baselines, from counts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from benchmark.completion_measure import COMPLETED
from benchmark.completion_recall import CHANCE, PAIRS, RECALL_1, RECALL_5
from benchmark.completion_scores import (
    Counts,
    ground_figures,
    mean_figures,
    plane_figures,
    ring_figures,
)
from benchmark.completion_speed import Milliseconds
from benchmark.table import Json, Table
from fewview.completion.layout.grid import CLASSES as GROUND_CLASSES
from fewview.completion.panorama.network import CLASSES

RINGS, GROUNDS, PLANES, RECALLS = "360-image", "2D layout", "planes", "descriptors"
UNSEEN, SEEN = "unobserved", "observed"
INSIDE = "unobserved inside"
GROUND_PARTS = (UNSEEN, INSIDE, "all")
RING_FIGURES = {
    "depth, relative": ("depth_relative", 3),
    "depth, m": ("depth_l1_m", 2),
    "within 10 %": ("depth_within_10_per_cent", 2),
    "normals, mean deg": ("normal_mean_deg", 1),
    "median deg": ("normal_median_deg", 1),
    "within 30 deg": ("normal_within_30", 2),
    "semantic IoU": ("semantics_iou", 3),
}
TOLERANCE, KINDS, PLANE_PARTS = "10 deg / 0.2 m", ("walls", "floor and ceiling"), ("seen", "unseen")
INTERVALS = 10
Rows = list[list[str]]


def summarise(counts: Counts) -> Json:
    """All figures of one set of rooms, by representation, method and part."""
    rings, grounds, planes, recalls = (
        _split(_split(counts).get(what, {})) for what in ("ring", "ground", "planes", "recall")
    )
    return {
        RINGS: {m: {p: ring_figures(c) for p, c in _split(of).items()} for m, of in rings.items()},
        GROUNDS: {
            m: {p: ground_figures(c) for p, c in _split(of).items()} for m, of in grounds.items()
        },
        PLANES: {method: plane_figures(of) for method, of in planes.items()},
        RECALLS: {network: mean_figures(of) for network, of in recalls.items()},
    }


def tables(summaries: Mapping[str, Json], speed: Milliseconds) -> list[Table]:
    """Tables of several sets of rooms by name; what no network was measured for is left out."""
    measured = next(iter(summaries.values()))
    made = {
        RINGS: (_ring_table, _class_table, _calibration_table),
        GROUNDS: (_ground_table,),
        PLANES: (_plane_table,),
        RECALLS: (_recall_table,),
    }
    found = [make(summaries) for what, makers in made.items() if measured[what] for make in makers]
    return [*found, _speed_table(speed)]


def _ring_table(summaries: Mapping[str, Json]) -> Table:
    rows: Rows = []
    for name, summary in summaries.items():
        rows.append([name])
        rows += [
            [label, *(_cell(found[figure], digits) for figure, digits in RING_FIGURES.values())]
            for label, found in _ring_rows(summary)
        ]
    note = (
        "Unobserved: outside the camera's view; observed: measured, where completion keeps the "
        "measured depth and its normals. Semantic IoU: mean over the classes that occur."
    )
    return Table("360-image", note, ["", *RING_FIGURES], rows)


def _class_table(summaries: Mapping[str, Json]) -> Table:
    rows: Rows = []
    for name, summary in summaries.items():
        found = [
            [label, *(_cell(found["iou"][c]) for c in CLASSES[1:])]
            for label, found in _ring_rows(summary)
            if found["semantics_iou"] is not None
        ]
        rows += [[name], *found] if found else []
    note = "Intersection over union; - where a class is neither true nor told."
    return Table("360-image, semantic IoU of each class", note, ["", *CLASSES[1:]], rows)


def _calibration_table(summaries: Mapping[str, Json]) -> Table:
    rows: Rows = []
    for name, summary in summaries.items():
        found = summary[RINGS][COMPLETED][UNSEEN]["calibration"]
        of = {round(INTERVALS * group["low"]): group for group in found["bins"]}
        every = sum(group["count"] for group in of.values())
        right = [_cell(of[b]["right"]) if b in of else "-" for b in range(INTERVALS)]
        share = [_cell(of[b]["count"] / every) if b in of else "-" for b in range(INTERVALS)]
        rows += [[f"{name}, right", *right, _cell(found["ece"], 3)]]
        rows += [[f"{name}, share of pixels", *share, ""]]
    note = (
        "Of the unobserved pixels whose confidence lies in an interval: share whose depth is "
        "within ten per cent, and how many they are. ECE: expected calibration error."
    )
    head = ["", *(f"{b / INTERVALS:.1f}-{(b + 1) / INTERVALS:.1f}" for b in range(INTERVALS))]
    return Table("360-image, what its confidence means", note, [*head, "ECE"], rows)


def _ground_table(summaries: Mapping[str, Json]) -> Table:
    rows: Rows = []
    for name, summary in summaries.items():
        cells = {part: summary[GROUNDS][COMPLETED][part]["cells"] for part in GROUND_PARTS}
        for part in GROUND_PARTS:
            if part == INSIDE and cells[part] == cells[UNSEEN]:
                continue
            found = {method: parts[part] for method, parts in summary[GROUNDS].items()}
            rows.append([f"{name}, {part}"])
            rows += [
                [method, *(_cell(f["iou"][c]) for c in GROUND_CLASSES[1:]), _cell(f["accuracy"])]
                for method, f in found.items()
            ]
    note = (
        "Intersection over union in the cells that the scan has no point in and did not look "
        "through (inside: those that are part of a room) and in all cells. What is seen and the "
        "nearest layout are told the true classes of seen cells. True meshes tell no doors from "
        "walls and nothing outside of the room; the latter does not count."
    )
    return Table("2D layout", note, ["", *GROUND_CLASSES[1:], "right cells"], rows)


def _plane_table(summaries: Mapping[str, Json]) -> Table:
    columns = [(figure, part) for figure in ("precision", "recall") for part in PLANE_PARTS]
    rows: Rows = []
    for name, summary in summaries.items():
        for kind in KINDS:
            rows.append([f"{name}, {kind}"])
            for method, tolerances in summary[PLANES].items():
                found = tolerances[TOLERANCE][kind]
                rows.append([method, *(_cell(found[part][figure]) for figure, part in columns)])
    note = (
        f"Within {TOLERANCE} of a true plane of the same kind. Seen: at least 30 of the scan's "
        "points lie on it."
    )
    return Table("Structural planes", note, ["", *map(", ".join, columns)], rows)


def _recall_table(summaries: Mapping[str, Json]) -> Table:
    rows: Rows = []
    for name, summary in summaries.items():
        rows.append([name])
        rows += [
            [f"{network}, {figure}", *(_cell(found.get(p, {}).get(figure), 3) for p in PAIRS)]
            for network, found in summary[RECALLS].items()
            for figure in (RECALL_1, RECALL_5, CHANCE)
        ]
    note = (
        "How often the most alike place in another view of the room (one of the five most alike) "
        "is the same place: within 0.16 m among 1024 of the 360-image, within 0.25 m among 128 "
        "cells of the layout, the same true wall among the walls told of the other view."
    )
    head = ["", "seen by both", "seen by one", "seen by none"]
    return Table("Descriptors", note, head, rows)


def _speed_table(speed: Milliseconds) -> Table:
    columns = list(next(iter(speed.values()), {}))
    rows = [[name, *(f"{ms[column]:.0f}" for column in columns)] for name, ms in speed.items()]
    note = "Milliseconds for a frame of 640 x 480 pixels that is levelled, best of several runs."
    return Table("Speed", note, ["", *columns], rows)


def _ring_rows(summary: Json) -> Iterator[tuple[str, Json]]:
    """Label and figures of all methods where nothing was seen, then of completion elsewhere."""
    for method, parts in summary[RINGS].items():
        yield f"{method}, {UNSEEN}", parts[UNSEEN]
    yield f"{COMPLETED}, {SEEN}", summary[RINGS][COMPLETED][SEEN]


def _split(counts: Counts) -> dict[str, Counts]:
    """Counts by the first part of their name, which is taken off."""
    out: dict[str, Counts] = {}
    for (first, *rest), value in counts.items():
        out.setdefault(first, {})[tuple(rest)] = value
    return out


def _cell(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
