"""A room seen from above: walls, doors, furniture and free floor on a fine grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fewview.synthetic.classes import Ground, Surface
from fewview.synthetic.plan import OpeningKind, Wall
from fewview.synthetic.rays import Caster
from fewview.synthetic.room import Room
from fewview.types import Array, BoolArray

CELL_M = 0.05
_MARGIN_M = 0.5
_WALL_M = 0.15
_LOW_M, _HIGH_M = 0.08, 2.2


@dataclass(frozen=True)
class FloorMap:
    """A top-down map of all rooms of a plan.

    Attributes:
        cells: (H, W) uint8 `Ground`; rows along y, columns along x.
        rooms: (H, W) uint8, bit i where the cell belongs to room i or to its walls.
        origin: (2,) x, y of the centre of the first cell, metres.
    """

    cells: NDArray[np.uint8]
    rooms: NDArray[np.uint8]
    origin: Array

    def at(self, points: Array) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Class and rooms under points (..., 2) of the world, UNKNOWN and 0 beyond the map."""
        column, row = np.moveaxis(np.rint((points - self.origin) / CELL_M).astype(int), -1, 0)
        height, width = self.cells.shape
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        row, column = row.clip(0, height - 1), column.clip(0, width - 1)
        return self.cells[row, column] * inside, self.rooms[row, column] * inside

    def places(self, clearance_m: float, room: int) -> Array:
        """(n, 2) centres of cells of a room with only free floor within ``clearance_m``."""
        free = self.cells == Ground.FREE
        reach = round(clearance_m / CELL_M)
        for axis in (0, 1):
            free = _eroded(free, reach, axis)
        row, column = np.nonzero(free & (self.rooms == 1 << room))
        return self.origin + CELL_M * np.stack([column, row], axis=-1)


def _eroded(mask: BoolArray, reach: int, axis: int) -> BoolArray:
    widths = [(reach + 1, reach) if a == axis else (0, 0) for a in (0, 1)]
    total = np.cumsum(np.pad(mask, widths), axis=axis, dtype=np.int32)
    first = np.arange(mask.shape[axis])
    count = total.take(first + 2 * reach + 1, axis=axis) - total.take(first, axis=axis)
    return np.asarray(count == 2 * reach + 1)


def floor_map(room: Room, caster: Caster) -> FloorMap:
    """Map all rooms of a plan."""
    corners = np.concatenate([plan.outline for plan in room.plan.rooms])
    low, high = corners.min(axis=0) - _MARGIN_M, corners.max(axis=0) + _MARGIN_M
    columns, rows = np.ceil((high - low) / CELL_M).astype(int)
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    points = low + CELL_M * np.stack([x, y], axis=-1).reshape(-1, 2)
    inside = [plan.contains(points) for plan in room.plan.rooms]
    within = np.logical_or.reduce(inside)
    cells, owners = (np.zeros(len(points), np.uint8) for _ in range(2))
    for number, plan in enumerate(room.plan.rooms):
        owners[inside[number]] |= 1 << number
        for wall in plan.walls:
            owners[_draw_wall(cells, points, wall, ~within)] |= 1 << number
    cells[within] = _standing(room, caster, points[within])
    for piece in room.standing:
        if piece.name == "column":
            cells[_inside(piece.footprint, points)] = Ground.WALL
    return FloorMap(cells.reshape(rows, columns), owners.reshape(rows, columns), low)


def _draw_wall(
    cells: NDArray[np.uint8], points: Array, wall: Wall, outside: BoolArray
) -> BoolArray:
    """Draw a wall and its doors; (n,) the cells that it covers."""
    along, across = wall.to_wall(points).T
    near = outside & (across > -_WALL_M) & (across <= 0)
    near &= (along > -_WALL_M) & (along < wall.length + _WALL_M)
    cells[near & (cells != Ground.DOOR)] = Ground.WALL
    for opening in wall.openings:
        if opening.kind is not OpeningKind.WINDOW:
            cells[near & (along > opening.left) & (along < opening.right)] = Ground.DOOR
    return np.asarray(near)


def _inside(polygon: Array, points: Array) -> BoolArray:
    """Which of (n, 2) points lie in a convex polygon (m, 2)."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    way = points[:, None] - polygon
    return np.asarray((edges[:, 0] * way[..., 1] >= edges[:, 1] * way[..., 0]).all(axis=1))


def _standing(room: Room, caster: Caster, points: Array) -> NDArray[np.uint8]:
    """The class at (n, 2) points in a room: looked up at from just above the floor."""
    beams = np.zeros((len(points), 6), np.float32)
    beams[:, :2], beams[:, 2], beams[:, 5] = points, _LOW_M, 1
    found = caster.cast(beams)
    met = found.depth < _HIGH_M - _LOW_M
    surface = room.surface[found.triangle // 2]
    cells = np.full(len(points), Ground.FREE, np.uint8)
    cells[met & (surface >= Surface.TABLE)] = Ground.FURNITURE
    cells[met & (surface == Surface.DOOR)] = Ground.DOOR
    return cells
