"""Completes views of a room and counts how it and the baselines compare with the truth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmark.completion_baselines import KINDS as BOX_KINDS
from benchmark.completion_baselines import (
    RingAnswer,
    Typical,
    box_around,
    box_ground,
    box_ring,
    seen_patches,
)
from benchmark.completion_networks import Networks
from benchmark.completion_recall import ground_recall, plane_arrays, ring_recall, wall_recall
from benchmark.completion_scores import (
    Counts,
    Key,
    ground_counts,
    ground_parts,
    means,
    plane_counts,
    ring_counts,
    ring_parts,
    seen_cells,
    total,
)
from benchmark.completion_views import View
from fewview.completion.layout.grid import UNKNOWN
from fewview.training.plane_figures import BELIEVED
from fewview.types import Array, CompletedLayout, CompletedPanorama, CompletedPlanes

COMPLETED, SURE = "completed", f"completed, confidence above {BELIEVED:g}"
TYPICAL, BOX, NEAREST = "median of training rooms", "box around what is seen", "nearest layout"
COPY, PATCHES = "what is seen", "patches that are seen"


def measured(
    views: Sequence[View], networks: Networks, usual: Typical, rng: np.random.Generator
) -> Counts:
    """Counts of all that the networks say of views of one room, and of the baselines.

    Keys are ``(ring | ground | planes, method, ...)``, see `completion_scores`, and
    ``(recall, network, figure)``.
    """
    rooms = [networks.complete(view.ring, view.points) for view in views]
    rings = [room.panorama for room in rooms if room.panorama is not None]
    grounds = [room.layout for room in rooms if room.layout is not None]
    planes = [room.planes for room in rooms if room.planes is not None]
    found: list[Counts] = []
    for view, room in zip(views, rooms, strict=True):
        box = box_around(view, usual.reach)
        if room.panorama is not None:
            found += _rings(view, room.panorama, usual, box)
        if room.layout is not None:
            found += _grounds(view, room.layout, usual, box)
        if room.planes is not None:
            found += _planes(view, room.planes, box)
    recalls: dict[str, dict[Key, float]] = {
        "360-image": ring_recall(views, rings, rng) if rings else {},
        "2D layout": ground_recall(views, grounds, rng) if grounds else {},
        "planes": wall_recall(views, planes) if planes else {},
    }
    found += [_under(means(of), "recall", network) for network, of in recalls.items()]
    return total(found)


def _rings(view: View, panorama: CompletedPanorama, usual: Typical, box: Array) -> list[Counts]:
    classes = panorama.semantics.argmax(axis=-1).astype(np.uint8)
    said = RingAnswer(panorama.depth, panorama.normals, classes, panorama.confidence)
    answers = {COMPLETED: said, TYPICAL: usual.ring, BOX: box_ring(box)}
    return [
        _under(ring_counts(answer, view.truth, where), "ring", method, part)
        for method, answer in answers.items()
        for part, where in ring_parts(view).items()
    ]


def _grounds(view: View, layout: CompletedLayout, usual: Typical, box: Array) -> list[Counts]:
    truth, seen = view.truth, seen_cells(view)
    told = seen & truth.ground_known
    answers = {
        COMPLETED: layout.classes,
        COPY: np.where(told, truth.ground, np.uint8(UNKNOWN)),
        NEAREST: usual.nearest(truth.ground, told),
        TYPICAL: usual.ground,
        BOX: box_ground(box, view),
    }
    sure = {COMPLETED: layout.confidence}
    return [
        _under(ground_counts(answer, truth, where, sure.get(method)), "ground", method, part)
        for method, answer in answers.items()
        for part, where in ground_parts(view, seen).items()
    ]


def _planes(view: View, completed: CompletedPlanes, box: Array) -> list[Counts]:
    planes, kinds = plane_arrays(completed)
    sure = np.array([p.confidence > BELIEVED for p in completed.planes], bool)
    answers = {
        COMPLETED: (planes, kinds),
        SURE: (planes[sure], kinds[sure]),
        PATCHES: seen_patches(view),
        BOX: (box, BOX_KINDS),
    }
    return [
        _under(plane_counts(*answer, view), "planes", method) for method, answer in answers.items()
    ]


def _under(counts: Counts, *where: str) -> Counts:
    return {(*where, *key): value for key, value in counts.items()}
