"""Completes views of a room and counts how it and the baselines compare with the truth."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import cast

import numpy as np
import torch

from benchmark.completion_baselines import (
    RingAnswer,
    Typical,
    box_around,
    box_ground,
    box_ring,
    seen_patches,
)
from benchmark.completion_networks import Networks
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
from fewview.geometry import se3
from fewview.synthetic.samples import RoomSample
from fewview.training import contrastive
from fewview.training.cell_matches import cell_matches, match_recall
from fewview.training.plane_figures import BELIEVED
from fewview.training.point_batches import CEILING, FLOOR, WALL
from fewview.types import Array, CompletedLayout, CompletedPanorama, CompletedPlanes

COMPLETED, SURE = "completed", f"completed, confidence above {BELIEVED:g}"
TYPICAL, BOX, NEAREST = "median of training rooms", "box around what is seen", "nearest layout"
COPY, PATCHES = "what is seen", "patches that are seen"
PLACES, CELLS_MATCHED = 320, 128
"""Of each pair of views, for the recall of descriptors."""
PAIRS = ("oo", "op", "pp")
"""Places that both views see, that one sees, that none sees."""
RECALL_1, RECALL_5, CHANCE = "recall@1", "recall@5", "chance"
KINDS = {"wall": WALL, "floor": FLOOR, "ceiling": CEILING}


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
    found: list[Counts] = []
    for view, room in zip(views, rooms, strict=True):
        box = box_around(view, usual.reach)
        if room.panorama is not None:
            found += _rings(view, room.panorama, usual, box)
        if room.layout is not None:
            found += _grounds(view, room.layout, usual, box)
        if room.planes is not None:
            found += _planes(view, room.planes, box)
    if rings:
        found.append(_under(means(_ring_recall(views, rings, rng)), "recall", "360-image"))
    if grounds:
        found.append(_under(means(_ground_recall(views, grounds, rng)), "recall", "2D layout"))
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
        COMPLETED: layout.probabilities.argmax(axis=0).astype(np.uint8),
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
    said = completed.planes
    planes = np.array([np.append(p.normal, p.normal @ p.centre) for p in said]).reshape(-1, 4)
    kinds = np.array([KINDS[p.kind] for p in said], np.uint8)
    sure = np.array([p.confidence > BELIEVED for p in said], bool)
    box_kinds = np.array([WALL] * 4 + [FLOOR, CEILING], np.uint8)
    answers = {
        COMPLETED: (planes, kinds),
        SURE: (planes[sure], kinds[sure]),
        PATCHES: seen_patches(view),
        BOX: (box, box_kinds),
    }
    return [
        _under(plane_counts(*answer, view), "planes", method) for method, answer in answers.items()
    ]


def _ring_recall(
    views: Sequence[View], rings: Sequence[CompletedPanorama], rng: np.random.Generator
) -> dict[Key, float]:
    """See `contrastive.recall`."""
    level_T_world = np.stack([view.level_T_world for view in views])
    shown = {
        "depth": np.stack([view.truth.depth for view in views]),
        "measured": np.stack([view.ring.depth for view in views]),
        "semantics": np.stack([view.truth.semantics for view in views]),
        "level_T_world": level_T_world,
    }
    room = cast(RoomSample, SimpleNamespace(**shown))
    batch = {
        "depth": torch.from_numpy(shown["depth"]),
        "world_T_level": torch.from_numpy(se3.inverse(level_T_world).astype(np.float32)),
        **contrastive.sample_pairs([room], PLACES, rng),
    }
    descriptors = torch.from_numpy(np.stack([ring.descriptors for ring in rings]))
    found = contrastive.recall(descriptors.permute(0, 3, 1, 2), batch)
    named = {RECALL_1: "recall_1", RECALL_5: "recall_5", CHANCE: "chance_1"}
    return {
        (pair, figure): found[f"{name}_{kind}"]
        for pair, kind in zip(PAIRS, contrastive.KINDS, strict=True)
        for figure, name in named.items()
    }


def _ground_recall(
    views: Sequence[View], layouts: Sequence[CompletedLayout], rng: np.random.Generator
) -> dict[Key, float]:
    """See `match_recall`."""
    grounds = np.stack([view.truth.ground for view in views])
    poses = np.stack([view.truth.grid_T_world for view in views])
    one_room = np.zeros(len(views), np.int64)
    batch = cell_matches(grounds, one_room, poses, CELLS_MATCHED, rng)
    descriptors = torch.from_numpy(np.stack([layout.descriptors for layout in layouts]))
    seen = torch.from_numpy(np.stack([layout.observed for layout in layouts]))
    found = match_recall(descriptors.permute(0, 3, 1, 2), seen, batch)
    return {
        (pair, figure): found.get(f"match_{name}", np.nan)
        for pair in PAIRS
        for figure, name in ((RECALL_1, f"{pair}_1"), (RECALL_5, f"{pair}_5"), (CHANCE, "chance_1"))
    }


def _under(counts: Counts, *where: str) -> Counts:
    return {(*where, *key): value for key, value in counts.items()}
