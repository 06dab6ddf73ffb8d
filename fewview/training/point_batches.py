"""From rooms to the points that the point networks are given, as a sensor would give them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from fewview.completion.layout.pointnet import PointBatch
from fewview.completion.layout.points import choose_pixels, points_of
from fewview.completion.panorama.ring import ring_normals
from fewview.geometry import se3
from fewview.training.problem import Batch
from fewview.types import Array, FloatArray, IntArray

if TYPE_CHECKING:
    from fewview.synthetic.samples import RoomSample

FLOOR, CEILING, WALL = 1, 2, 3


@dataclass(frozen=True)
class RoomPoints:
    """The cameras of several rooms, B in all, each with N of its points.

    Attributes:
        batch: what the networks are given.
        turns: (B, 3, 3) from the level frames to the true wall frames.
        tilts: (B, 3, 3) rotation of the given points against the true wall frame.
        floor: (B, 3) h, a, b of the floor z = h + a x + b y as the tilted points have it.
        room: (B,) number of the room.
        frame_T_world: (B, 4, 4) into the wall frames, without the tilt.
    """

    batch: PointBatch
    turns: Array
    tilts: Array
    floor: Tensor
    room: Tensor
    frame_T_world: Array

    def tensors(self) -> Batch:
        """The batch, the floor and the rooms by name."""
        return {**self.batch._asdict(), "floor": self.floor, "room": self.room}


def room_points(
    rooms: Sequence[RoomSample], count: int, tilt_deg: float, rng: np.random.Generator
) -> RoomPoints:
    """Sample the measured points of every camera.

    Args:
        rooms: R rooms.
        count: points per camera.
        tilt_deg: standard deviation of the error of the level frame about each horizontal axis.
        rng: chooses points and tilts.
    """
    views = [(room, v) for room in rooms for v in range(len(room.depth))]
    normals = ring_normals(torch.from_numpy(np.concatenate([r.measured for r in rooms])))
    normal_images = normals.permute(0, 2, 3, 1).numpy()
    scans = []
    for (room, v), normal in zip(views, normal_images, strict=True):
        chosen = choose_pixels(room.measured[v], rng, count)
        scans.append(points_of(room.measured[v], room.colour[v], normal, chosen, count))
    tilts = se3.rotation_exp(np.radians(rng.normal(0, tilt_deg, (len(views), 3))) * [1, 1, 0])
    level_T_world = np.concatenate([room.level_T_world for room in rooms])
    batch = PointBatch.of(scans)
    turns = np.stack([scan.wall_R_level for scan in scans]).astype(np.float64)
    turn = torch.from_numpy(tilts.astype(np.float32)).mT
    batch = batch._replace(points=batch.points @ turn, normals=batch.normals @ turn)
    return RoomPoints(
        batch=batch,
        turns=turns,
        tilts=tilts,
        floor=torch.from_numpy(_floors(rooms, tilts)),
        room=torch.tensor([i for i, room in enumerate(rooms) for _ in room.depth]),
        frame_T_world=se3.pose(turns, np.zeros((len(turns), 3))) @ level_T_world,
    )


def given(batch: Batch) -> PointBatch:
    """The networks' input out of named tensors."""
    return PointBatch(*(batch[name] for name in PointBatch._fields))


def neighbours(room: IntArray) -> list[tuple[int, int]]:
    """Each camera with the next one of its room; ``room`` (B,) numbers the cameras' rooms."""
    pairs = []
    for number in np.unique(room):
        cameras = np.flatnonzero(room == number)
        if len(cameras) > 1:
            pairs += list(zip(cameras, np.roll(cameras, -1), strict=True))
    return [(int(a), int(b)) for a, b in pairs]


def _floors(rooms: Sequence[RoomSample], tilts: Array) -> FloatArray:
    planes = np.concatenate([room.planes for room in rooms]).astype(np.float64)
    kinds = np.concatenate([room.plane_kind for room in rooms])
    floors = planes[np.arange(len(planes)), (kinds == FLOOR).argmax(axis=1)]
    normals = (tilts @ floors[:, :3, None])[..., 0]
    flat = np.stack([floors[:, 3], -normals[:, 0], -normals[:, 1]], axis=1)
    return np.asarray(flat / normals[:, 2:], dtype=np.float32)
