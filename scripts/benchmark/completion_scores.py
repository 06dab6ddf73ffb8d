"""Completed rooms against the truth, as counts that add up over views and rooms."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from benchmark.completion_baselines import Bytes, RingAnswer, level_points
from benchmark.completion_views import Truth, View
from fewview.completion.layout.grid import CLASSES as GROUND_CLASSES
from fewview.completion.layout.grid import DOOR, UNKNOWN, WALL, cells_of
from fewview.completion.layout.pointnet import PointBatch
from fewview.completion.layout.pooling import seen_through
from fewview.completion.panorama.complete import CONFIDENT_ERROR
from fewview.completion.panorama.network import CLASSES
from fewview.evaluation.calibration import bins_of, calibration_error, reliability_counts
from fewview.evaluation.segmentation import accuracy, confusion, ious, mean_iou
from fewview.training.plane_matches import MIN_SEEN
from fewview.training.point_batches import WALL as WALL_PLANE
from fewview.types import Array, BoolArray, FloatArray

Key = tuple[str, ...]
Counts = dict[Key, NDArray[Any]]
"""Arrays to be added, by what they count."""
Json = dict[str, Any]

ANGLE_BINS = 360
"""Of the angles between normals, 0..180 degrees."""
TOLERANCES = {"10 deg / 0.2 m": (10.0, 0.2), "15 deg / 0.3 m": (15.0, 0.3)}
"""How near a plane is to be to a true one of its kind to be right."""
ON_PLANE_M, ON_PLANE_COS = 0.1, 0.9
"""Points on a true plane."""


def total(counts: Iterable[Counts]) -> Counts:
    """Add the counts of several views or rooms."""
    out: Counts = {}
    for one in counts:
        for key, value in one.items():
            out[key] = out[key] + value if key in out else value
    return out


def ring_parts(view: View) -> dict[str, BoolArray]:
    """Pixels that the camera did not look at, those that it saw, and holes in what it saw."""
    truth, measured = view.truth, view.ring.depth > 0
    known = truth.depth > 0
    return {
        "unobserved": known & ~truth.in_view & ~measured,
        "observed": known & measured,
        "holes": known & truth.in_view & ~measured,
    }


def ring_counts(answer: RingAnswer, truth: Truth, where: BoolArray) -> Counts:
    """What a completed ring is off by in some of its pixels; see `ring_figures`."""
    depth, right = answer.depth[where], truth.depth[where]
    off = np.abs(depth - right)
    near = off < CONFIDENT_ERROR * right
    turned = where & (np.linalg.norm(truth.normals, axis=-1) > 0.5)
    cosine = (answer.normals * truth.normals).sum(axis=-1)[turned].clip(-1.0, 1.0)
    angles, _ = np.histogram(np.degrees(np.arccos(cosine)), ANGLE_BINS, (0.0, 180.0))
    named = where & (truth.semantics > 0)
    classes = confusion(truth.semantics[named], answer.semantics[named], len(CLASSES))
    out: Counts = {
        ("depth",): np.array([len(off), off.sum(), (off / right).sum(), near.sum()], np.float64),
        ("normals",): angles.astype(np.float64),
        ("semantics",): classes,
    }
    if answer.confidence is not None:
        out[("confidence",)] = reliability_counts(answer.confidence[where], near)
    return out


def ring_figures(counts: Counts) -> Json:
    """Figures of `ring_counts`; None where there is nothing to measure."""
    pixels, metres, relative, near = counts[("depth",)].tolist()
    angles, classes = counts[("normals",)], counts[("semantics",)]
    middles = (np.arange(ANGLE_BINS) + 0.5) * 180.0 / ANGLE_BINS
    below, turned = np.cumsum(angles), float(angles.sum())
    median = float(middles[int(np.searchsorted(below, 0.5 * turned))])
    out: Json = {
        "pixels": int(pixels),
        "depth_relative": _ratio(relative, pixels),
        "depth_l1_m": _ratio(metres, pixels),
        "depth_within_10_per_cent": _ratio(near, pixels),
        "normal_mean_deg": _ratio(float(angles @ middles), turned),
        "normal_median_deg": median if turned else None,
        "normal_within_30": _ratio(float(angles[middles < 30.0].sum()), turned),
        "semantics_iou": _number(mean_iou(classes)),
        "semantics_accuracy": _number(accuracy(classes)),
        "iou": _named(CLASSES[1:], ious(classes)[1:]),
    }
    return out | _calibration(counts)


def seen_cells(view: View) -> BoolArray:
    """(G, G) cells with a point of the scan, or that it looked through over the true floor."""
    batch = PointBatch.of([view.points])
    floor = torch.tensor([[view.truth.floor_z, 0.0, 0.0]])
    seen = seen_through(batch.points, floor, batch.valid)[0].amax(dim=0).flatten() > 0
    cells, inside = cells_of(batch.points[0])
    seen[cells[inside & batch.valid[0]]] = True
    return np.asarray(seen.reshape(view.truth.ground.shape).numpy())


def ground_parts(view: View, seen: BoolArray) -> dict[str, BoolArray]:
    """Cells that were not seen, those of them inside of rooms, and all that are known."""
    known = view.truth.ground_known
    inside = known & (view.truth.ground != UNKNOWN)
    return {"unobserved": known & ~seen, "unobserved inside": inside & ~seen, "all": known}


def ground_counts(
    answer: Bytes, truth: Truth, where: BoolArray, confidence: FloatArray | None = None
) -> Counts:
    """Right and wrong cells (G, G) of a layout; see `ground_figures`.

    Where the truth does not tell doors from walls, doors in the answer count as walls.
    """
    if not truth.doors_known:
        answer = np.where(answer == DOOR, np.uint8(WALL), answer)
    out: Counts = {("cells",): confusion(truth.ground[where], answer[where], len(GROUND_CLASSES))}
    if confidence is not None:
        right = (answer == truth.ground)[where]
        out[("confidence",)] = reliability_counts(confidence[where], right)
    return out


def ground_figures(counts: Counts) -> Json:
    """Figures of `ground_counts`; None where there is nothing to measure."""
    cells = counts[("cells",)]
    out: Json = {
        "cells": int(cells.sum()),
        "accuracy": _number(accuracy(cells)),
        "mean_iou": _number(mean_iou(cells)),
        "iou": _named(GROUND_CLASSES, ious(cells)),
    }
    return out | _calibration(counts)


def plane_counts(planes: Array, kinds: Bytes, view: View) -> Counts:
    """How many of planes (n, 4) of kinds (n,) are right and which true ones are among them.

    A plane is right within a tolerance of a true one of its kind; true ones are split by whether
    at least `MIN_SEEN` of the scan's points lie on them, and so are the planes of the answer.
    """
    truth = view.truth
    alike = kinds[:, None] == truth.kinds
    claimed, there = planes_seen(planes, view), planes_seen(truth.planes, view)
    out: Counts = {}
    for name, (angle, away) in TOLERANCES.items():
        near = alike & same_plane(planes, truth.planes, angle, away)
        right, found = near.any(axis=1), near.any(axis=0)
        for kind, mine, true in (
            ("walls", kinds == WALL_PLANE, truth.kinds == WALL_PLANE),
            ("floor and ceiling", kinds != WALL_PLANE, truth.kinds != WALL_PLANE),
        ):
            for part, ours, theirs in (
                ("seen", mine & claimed, true & there),
                ("unseen", mine & ~claimed, true & ~there),
            ):
                numbers = [ours.sum(), (ours & right).sum(), theirs.sum(), (theirs & found).sum()]
                out[(name, kind, part)] = np.array(numbers, np.float64)
    return out


def plane_figures(counts: Counts) -> Json:
    """Precision and recall of `plane_counts` by tolerance and kind, seen, unseen and all."""
    out: Json = {}
    for name, kind, _ in counts:
        seen, unseen = (counts[(name, kind, part)] for part in ("seen", "unseen"))
        parts = {"seen": seen, "unseen": unseen, "all": seen + unseen}
        out.setdefault(name, {})[kind] = {part: _found(*v) for part, v in parts.items()}
    return out


def same_plane(first: Array, second: Array, angle_deg: float, away_m: float) -> BoolArray:
    """(n, m) which of planes (n, 4) and (m, 4) differ less than this in normal and offset."""
    aligned = first[:, :3] @ second[:, :3].T > math.cos(math.radians(angle_deg))
    return np.asarray(aligned & (np.abs(first[:, None, 3] - second[None, :, 3]) < away_m))


def planes_seen(planes: Array, view: View) -> BoolArray:
    """(n,) on which of planes (n, 4) enough of the scan's points lie."""
    points, normals = level_points(view)
    on = np.abs(points @ planes[:, :3].T - planes[:, 3]) < ON_PLANE_M
    on &= normals @ planes[:, :3].T > ON_PLANE_COS
    return np.asarray(on.sum(axis=0) >= MIN_SEEN)


def means(values: Mapping[Key, float]) -> Counts:
    """Shares of one room as counts, those that are no numbers left out; see `mean_figures`."""
    return {key: np.array([v, 1.0]) for key, v in values.items() if math.isfinite(v)}


def mean_figures(counts: Counts) -> Json:
    """The mean of each share over the rooms that have it, by the two parts of its name."""
    out: Json = {}
    for (pair, figure), (summed, rooms) in counts.items():
        out.setdefault(pair, {})[figure] = float(summed / rooms)
    return out


def _found(told: float, right: float, true: float, found: float) -> Json:
    precision, recall = _ratio(right, told), _ratio(found, true)
    return {"precision": precision, "recall": recall, "told": int(told), "true": int(true)}


def _calibration(counts: Counts) -> Json:
    if ("confidence",) not in counts:
        return {}
    bins = bins_of(counts[("confidence",)])
    return {"calibration": {"ece": calibration_error(bins), "bins": [vars(b) for b in bins]}}


def _named(names: Sequence[str], values: Array) -> dict[str, float | None]:
    return {name: _number(float(v)) for name, v in zip(names, values, strict=True)}


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _ratio(value: float, count: float) -> float | None:
    return float(value / count) if count else None
