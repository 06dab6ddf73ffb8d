"""A room seen from above: walls, doors, furniture and free floor on a fine grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from fewview.synthetic.classes import Ground, PlaneKind, Surface
from fewview.synthetic.plan import OpeningKind, Plan, Wall
from fewview.synthetic.room import Room
from fewview.types import Array, BoolArray

CELL_M = 0.05
_MARGIN_M = 0.5
_WALL_M = 0.15
_LOW_M, _HIGH_M = 0.08, 2.2


@dataclass(frozen=True)
class FloorMap:
    """A top-down map of a whole room.

    Attributes:
        cells: (H, W) uint8 `Ground`; rows along y, columns along x.
        origin: (2,) x, y of the centre of the first cell, metres.
    """

    cells: NDArray[np.uint8]
    origin: Array

    def at(self, points: Array) -> NDArray[np.uint8]:
        """The class under points (..., 2) of the world, UNKNOWN beyond the map."""
        column, row = np.moveaxis(np.rint((points - self.origin) / CELL_M).astype(int), -1, 0)
        height, width = self.cells.shape
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        found = self.cells[row.clip(0, height - 1), column.clip(0, width - 1)]
        return np.where(inside, found, np.uint8(Ground.UNKNOWN))

    def places(self, clearance_m: float) -> Array:
        """(n, 2) centres of free cells with nothing but free floor within ``clearance_m``."""
        free = self.cells == Ground.FREE
        reach = round(clearance_m / CELL_M)
        for axis in (0, 1):
            free = _eroded(free, reach, axis)
        row, column = np.nonzero(free)
        return self.origin + CELL_M * np.stack([column, row], axis=-1)


def _eroded(mask: BoolArray, reach: int, axis: int) -> BoolArray:
    total = np.cumsum(
        np.pad(mask, [(reach + 1, reach) if a == axis else (0, 0) for a in (0, 1)]),
        axis=axis,
        dtype=np.int32,
    )
    count = mask.shape[axis]
    high = np.take(total, np.arange(count) + 2 * reach + 1, axis=axis)
    low = np.take(total, np.arange(count), axis=axis)
    return np.asarray(high - low == 2 * reach + 1)


def floor_map(room: Room) -> FloorMap:
    """Map a room."""
    low = room.plan.outline.min(axis=0) - _MARGIN_M
    high = room.plan.outline.max(axis=0) + _MARGIN_M
    columns, rows = np.ceil((high - low) / CELL_M).astype(int)
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    points = low + CELL_M * np.stack([x, y], axis=-1).reshape(-1, 2)
    cells = np.full(len(points), Ground.UNKNOWN, np.uint8)
    inside = room.plan.contains(points)
    for wall in room.plan.walls:
        _draw_wall(cells, points, wall, ~inside)
    cells[inside] = np.where(_occupied(room, points[inside]), Ground.FURNITURE, Ground.FREE)
    return FloorMap(cells.reshape(rows, columns), low)


def _draw_wall(cells: NDArray[np.uint8], points: Array, wall: Wall, outside: BoolArray) -> None:
    along, across = ((points - wall.start) @ wall.world_T_wall[:2, :2]).T
    near = outside & (across > -_WALL_M) & (across <= 0)
    near &= (along > -_WALL_M) & (along < wall.length + _WALL_M)
    cells[near] = Ground.WALL
    for opening in wall.openings:
        if opening.kind is OpeningKind.DOOR:
            cells[near & (along > opening.left) & (along < opening.right)] = Ground.DOOR


def _occupied(room: Room, points: Array) -> BoolArray:
    """Whether (n, 2) points have furniture above them: looked up at from just above the floor."""
    beams = np.zeros((len(points), 6), np.float32)
    beams[:, :2], beams[:, 2], beams[:, 5] = points, _LOW_M, 1
    found = room.scene.cast_rays(o3d.core.Tensor(beams))
    height = _LOW_M + found["t_hit"].numpy()
    quad = np.where(np.isfinite(height), found["primitive_ids"].numpy(), 0) // 2
    return np.asarray((height < _HIGH_M) & (room.surface[quad] >= Surface.TABLE))


def outline_planes(plan: Plan) -> tuple[Array, NDArray[np.uint8]]:
    """Structural planes (p, 4) of a plan, normal into the room and offset, and their kinds."""
    planes = [[0, 0, 1, 0.0], [0, 0, -1, -plan.height]]
    for wall in plan.walls:
        normal = wall.world_T_wall[:3, 1]
        planes.append([*normal, float(normal[:2] @ wall.start)])
    kinds = [PlaneKind.FLOOR, PlaneKind.CEILING] + [PlaneKind.WALL] * len(plan.walls)
    return np.array(planes), np.array(kinds, np.uint8)
