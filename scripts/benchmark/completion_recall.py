"""How often descriptors of completed rooms find the same place in another view of the room."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from types import SimpleNamespace
from typing import cast

import numpy as np
import torch
from numpy.typing import NDArray

from benchmark.completion_scores import TOLERANCES, Key, planes_seen, same_plane
from benchmark.completion_views import View
from fewview.geometry import se3
from fewview.synthetic.samples import RoomSample
from fewview.training import contrastive
from fewview.training.cell_matches import cell_matches, match_recall
from fewview.training.point_batches import CEILING, FLOOR, WALL
from fewview.types import (
    Array,
    BoolArray,
    CompletedLayout,
    CompletedPanorama,
    CompletedPlanes,
    FloatArray,
)

PAIRS = ("oo", "op", "pp")
"""Places that both views see, that one sees, that none sees."""
RECALL_1, RECALL_5, CHANCE = "recall@1", "recall@5", "chance"
PLACES, CELLS_MATCHED = 320, 128
"""Of each pair of views."""
KINDS = {"wall": WALL, "floor": FLOOR, "ceiling": CEILING}
RIGHT, SAME_WALL = TOLERANCES["15 deg / 0.3 m"], (5.0, 0.1)
"""How near a told wall is to be to a true one, and true walls of two views to be the same."""


def ring_recall(
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


def ground_recall(
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


@dataclass(frozen=True)
class _Walls:
    """The walls that are told of one view.

    Attributes:
        descriptors: (n, D).
        seen: (n,) whether enough of the scan's points lie on each.
        world: (n, 4) the true wall that each is nearest to, in the world.
        right: (n,) whether it is near enough.
    """

    descriptors: FloatArray
    seen: BoolArray
    world: Array
    right: BoolArray


def wall_recall(views: Sequence[View], completed: Sequence[CompletedPlanes]) -> dict[Key, float]:
    """How often the most alike of the walls told of another view is the same true wall.

    Walls that are not right, or that no right one of the other view is the same as, do not count.
    """
    walls = [_walls(view, planes) for view, planes in zip(views, completed, strict=True)]
    found: dict[Key, list[float]] = {}
    for a, b in permutations(walls, 2):
        same = same_plane(a.world, b.world, *SAME_WALL) & a.right[:, None] & b.right
        order = (a.descriptors @ b.descriptors.T).argsort(axis=1)[:, ::-1]
        hits = np.take_along_axis(same, order, axis=1)
        for wall in np.flatnonzero(same.any(axis=1)):
            pair = PAIRS[2 - int(a.seen[wall]) - int(b.seen[same[wall]].any())]
            figures = hits[wall, 0], hits[wall, :5].any(), hits[wall].mean()
            for figure, value in zip((RECALL_1, RECALL_5, CHANCE), figures, strict=True):
                found.setdefault((pair, figure), []).append(float(value))
    return {key: float(np.mean(values)) for key, values in found.items()}


def plane_arrays(completed: CompletedPlanes) -> tuple[Array, NDArray[np.uint8]]:
    """The planes (n, 4) of a completed scan, normal and offset, and their `PlaneKind` (n,)."""
    planes = [np.append(p.normal, p.normal @ p.centre) for p in completed.planes]
    kinds = np.array([KINDS[p.kind] for p in completed.planes], np.uint8)
    return np.array(planes, np.float64).reshape(-1, 4), kinds


def _walls(view: View, completed: CompletedPlanes) -> _Walls:
    planes, kinds = plane_arrays(completed)
    told, true = planes[kinds == WALL], view.truth.planes[view.truth.kinds == WALL]
    near = same_plane(told, true, *RIGHT)
    away = np.abs(told[:, None, 3] - true[None, :, 3])
    nearest = np.where(near, away, np.inf).argmin(axis=1)
    world_T_level = se3.inverse(view.level_T_world)
    normals = se3.rotate(world_T_level, true[:, :3])
    world = np.column_stack([normals, true[:, 3] + normals @ world_T_level[:3, 3]])
    size = len(completed.descriptors.T)
    descriptors = [p.descriptor for p in completed.planes if p.kind == "wall"]
    return _Walls(
        np.array(descriptors, np.float32).reshape(-1, size),
        planes_seen(told, view),
        world[nearest],
        np.asarray(near.any(axis=1)),
    )
