"""The structure network's batches: points, the planes that they lie on, and walls in slots."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray

from fewview.completion.panorama.ring import ring_rays
from fewview.training.point_batches import neighbours, room_points
from fewview.training.problem import Batch
from fewview.training.structure_targets import PlaneTruth, plane_of, plane_truth, turned, wall_slots
from fewview.types import FloatArray, IntArray

if TYPE_CHECKING:
    from fewview.synthetic.samples import RoomSample


def structure_batch(
    rooms: Sequence[RoomSample],
    points: int,
    tilt_deg: float,
    matches: int,
    rng: np.random.Generator,
) -> Batch:
    """All cameras of some rooms, B in all, with N points each and P planes at most.

    Args:
        rooms: where the cameras are.
        points: N.
        tilt_deg: see `room_points`.
        matches: M, points of each camera whose descriptors are compared.
        rng: draws all of it.

    Returns:
        what `RoomPoints.tensors` names, and
        ``plane`` (B, P, 4), ``plane_kind`` (B, P), ``plane_centre`` (B, P, 3), ``plane_known``
        (B, P), see `PlaneTruth`;
        ``level_plane`` (B, 2), see `PlaneTruth`;
        ``point_plane`` (B, N) index or -1, ``point_normal`` (B, N, 3), ``point_class`` (B, N);
        ``wall_plane``, ``wall_azimuth``, ``wall_distance``, ``wall_middle``,
        ``wall_middle_known`` (B, K), see `Slots`;
        ``match_pairs`` (Q, 2) cameras, ``match_points`` (B, M) points.
        All in the wall frames; points, their normals and the planes' centres are tilted too.
    """
    scans = room_points(rooms, points, tilt_deg, rng)
    tilts = scans.tilts.astype(np.float32).swapaxes(1, 2)
    turns = scans.turns.astype(np.float32)
    truth = turned(
        PlaneTruth(*map(np.concatenate, zip(*map(plane_truth, rooms), strict=True))), turns
    )
    slots = wall_slots(truth)
    views = [(room, v) for room in rooms for v in range(len(room.depth))]
    of_points = [
        _true_points(*view, pixels)
        for view, pixels in zip(views, scans.batch.pixels.numpy(), strict=True)
    ]
    label, normal, surface = (np.stack(column) for column in zip(*of_points, strict=True))
    label = np.where(scans.batch.valid.numpy(), label, -1)
    arrays = {
        "plane": truth.planes,
        "plane_kind": truth.kind.astype(np.int64),
        "plane_centre": truth.centre @ tilts,
        "plane_known": truth.known,
        "level_plane": truth.level,
        "point_plane": label,
        "point_normal": normal @ turns.swapaxes(1, 2) @ tilts,
        "point_class": surface.astype(np.int64),
        "wall_plane": slots.plane,
        "wall_azimuth": slots.azimuth,
        "wall_distance": slots.distance,
        "wall_middle": slots.middle,
        "wall_middle_known": slots.middle_known,
        "match_pairs": np.array(neighbours(scans.room.numpy()), np.int64).reshape(-1, 2),
        "match_points": np.stack([_spread(row, matches, rng) for row in label]),
    }
    return {**scans.tensors(), **{k: torch.from_numpy(array) for k, array in arrays.items()}}


def _true_points(
    room: RoomSample, view: int, pixels: IntArray
) -> tuple[IntArray, FloatArray, NDArray[np.uint8]]:
    """Plane (N,), normal (N, 3) and class (N,) that the ring truly has at flat pixels (N,)."""
    depth = room.depth[view]
    points = (ring_rays(len(depth)) * depth[..., None]).reshape(-1, 3)[pixels]
    normals, surface = (
        room.normal[view].reshape(-1, 3)[pixels],
        room.semantics[view].ravel()[pixels],
    )
    planes, kind = room.planes[view], room.plane_kind[view]
    label = plane_of(points, normals, surface, planes.astype(np.float64), kind)
    return label, normals, surface


def _spread(label: IntArray, count: int, rng: np.random.Generator) -> IntArray:
    """Choose points, each plane about as often as any other; any points where there is none."""
    shown = np.flatnonzero(label >= 0)
    if not len(shown):
        return np.zeros(count, np.int64)
    weight = 1.0 / np.bincount(label[shown])[label[shown]]
    return np.asarray(rng.choice(shown, count, p=weight / weight.sum()), np.int64)
