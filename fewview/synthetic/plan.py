"""The plan of a room: its outline, ceilings, walls with doors and windows, and rooms next door."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property

import numpy as np

from fewview.synthetic import ceilings
from fewview.synthetic.items import placement
from fewview.synthetic.shapes import Shape, make_shape, rectangle
from fewview.synthetic.textures import Rng
from fewview.types import Array, BoolArray, IntArray

_OPENING_M = 2.2


class OpeningKind(StrEnum):
    """What is inset in a wall; a passage leads into the room next door."""

    DOOR = "door"
    WINDOW = "window"
    PASSAGE = "passage"


@dataclass(frozen=True)
class Opening:
    """A rectangle of a wall.

    Attributes:
        kind: what is in it.
        left: where it begins along the wall, metres.
        right: where it ends.
        sill: height of its lower edge.
        top: height of its upper edge.
        deep: how far the leaf or pane stands back, or how thick the wall is at a passage.
    """

    kind: OpeningKind
    left: float
    right: float
    sill: float
    top: float
    deep: float


@dataclass(frozen=True, eq=False)
class Wall:
    """A straight wall; the room is on its left going from start to end.

    Attributes:
        start: (2,) metres.
        end: (2,) metres.
        openings: from start to end, disjoint.
    """

    start: Array
    end: Array
    openings: tuple[Opening, ...]

    @cached_property
    def length(self) -> float:
        return float(np.linalg.norm(self.end - self.start))

    @cached_property
    def world_T_wall(self) -> Array:
        """(4, 4): x along the wall, y into the room, z up, origin at the start on the floor."""
        yaw = float(np.arctan2(*(self.end - self.start)[::-1]))
        return placement(float(self.start[0]), float(self.start[1]), 0.0, yaw)

    def to_world(self, points: Array) -> Array:
        """(..., 2) points of the floor in the wall's frame to the world's."""
        return np.asarray(points @ self.world_T_wall[:2, :2].T + self.start)

    def to_wall(self, points: Array) -> Array:
        """(..., 2) points of the floor in the world to the wall's frame."""
        return np.asarray((points - self.start) @ self.world_T_wall[:2, :2])


@dataclass(frozen=True, eq=False)
class Plan:
    """A floor plan of one room.

    Attributes:
        outline: (n, 2) corners, counter-clockwise, metres.
        parts: (k, 4, 2) convex quadrilaterals that tile it.
        ceilings: planes (m, 3) above each part; see `fewview.synthetic.ceilings`.
        walls: one per side of the outline.
        neighbours: rooms that a passage of this one leads to.
    """

    outline: Array
    parts: Array
    ceilings: tuple[Array, ...]
    walls: tuple[Wall, ...]
    neighbours: tuple[Plan, ...] = ()

    @property
    def rooms(self) -> tuple[Plan, ...]:
        """This room and those next door."""
        return (self, *self.neighbours)

    @cached_property
    def height(self) -> float:
        """Of the highest point of the ceiling."""
        return max(
            float(corners[..., 2].max())
            for planes, part in zip(self.ceilings, self.parts, strict=True)
            for _, corners in ceilings.faces(planes, part)
        )

    def contains(self, points: Array) -> BoolArray:
        """Which of (n, 2) points lie inside the outline (even-odd rule)."""
        a, b = self.outline, np.roll(self.outline, -1, axis=0)
        x, y = points[:, :1], points[:, 1:]
        crosses = (a[:, 1] > y) != (b[:, 1] > y)
        rise = np.where(a[:, 1] == b[:, 1], 1.0, b[:, 1] - a[:, 1])
        left = x < a[:, 0] + (y - a[:, 1]) * (b[:, 0] - a[:, 0]) / rise
        return np.asarray((crosses & left).sum(axis=1) % 2 == 1)

    def part_at(self, points: Array) -> IntArray:
        """The part in or nearest to which each of (n, 2) points lies."""
        edge = np.roll(self.parts, -1, axis=1) - self.parts
        edge /= np.linalg.norm(edge, axis=-1, keepdims=True)
        way = points[:, None, None] - self.parts
        inward = edge[..., 0] * way[..., 1] - edge[..., 1] * way[..., 0]
        return np.asarray(inward.min(axis=-1).argmax(axis=-1), np.int64)

    def height_at(self, points: Array) -> Array:
        """(n,) heights of the ceiling over (n, 2) points."""
        over = np.stack([ceilings.heights(planes, points) for planes in self.ceilings], axis=-1)
        return np.asarray(np.take_along_axis(over, self.part_at(points)[:, None], axis=1)[:, 0])


def make_plan(rng: Rng) -> Plan:
    """A room with doors and windows, half of the time with a room or a corridor next door."""
    shape = make_shape(rng)
    above = ceilings.make_ceilings(rng, shape)
    bare = _walled(shape, above)
    high = _high_stretches(bare)
    plan = _opened(rng, bare, high, _opening_kinds(rng, np.ptp(high, axis=1)))
    return _adjoined(rng, plan) if rng.uniform() < 0.5 else plan


def _walled(shape: Shape, above: tuple[Array, ...]) -> Plan:
    ends = np.roll(shape.outline, -1, axis=0)
    walls = tuple(Wall(a, b, ()) for a, b in zip(shape.outline, ends, strict=True))
    return Plan(shape.outline, shape.parts, above, walls)


def _high_stretches(plan: Plan) -> list[tuple[float, float]]:
    """From where to where each wall is high enough for doors and windows; (0, 0) for nowhere."""
    out = []
    for wall in plan.walls:
        x = np.linspace(0, wall.length, 33)
        inside = wall.to_world(np.stack([x, np.full(33, 0.01)], axis=-1))
        high = x[plan.height_at(inside) > _OPENING_M]
        out.append((float(high[0]), float(high[-1])) if len(high) else (0.0, 0.0))
    return out


def _opening_kinds(rng: Rng, lengths: Array) -> list[list[OpeningKind]]:
    """Doors and windows of walls, given the length of each that may have some."""
    kinds: list[list[OpeningKind]] = [[] for _ in lengths]
    order = rng.permutation(np.flatnonzero(lengths > 1.4))
    if len(order) == 0:
        return kinds
    kinds[order[0]].append(OpeningKind.DOOR)
    for number in order[1 : 1 + rng.integers(0, 3)]:
        most = 1 + max(1, int(lengths[number] / 2.2))
        kinds[number] += [OpeningKind.WINDOW] * int(rng.integers(1, most))
    if rng.uniform() < 0.3:
        kinds[order[-1]].append(OpeningKind.DOOR)
    return kinds


def _opened(
    rng: Rng, plan: Plan, high: list[tuple[float, float]], kinds: list[list[OpeningKind]]
) -> Plan:
    walls = tuple(
        Wall(w.start, w.end, _openings(rng, h, k))
        for w, h, k in zip(plan.walls, high, kinds, strict=True)
    )
    return replace(plan, walls=walls)


def _openings(rng: Rng, high: tuple[float, float], kinds: list[OpeningKind]) -> tuple[Opening, ...]:
    out = []
    slot = (high[1] - high[0]) / max(1, len(kinds))
    full_length = rng.uniform() < 0.15
    for i, kind in enumerate(kinds):
        window = kind is OpeningKind.WINDOW
        width = rng.uniform(0.9, 2.2) if window else rng.uniform(0.8, 0.95)
        width = min(width, slot - 0.5)
        left = high[0] + slot * i + rng.uniform(0.2, max(0.21, slot - width - 0.2))
        sill = 0.0 if not window else 0.06 if full_length else rng.uniform(0.7, 1.05)
        top, deep = rng.uniform(1.98, 2.1), rng.uniform(0.06, 0.2) if window else 0.04
        out.append(Opening(kind, left, left + width, sill, top, deep))
    return tuple(out)


def _adjoined(rng: Rng, plan: Plan) -> Plan:
    """The plan with doors made passages into new rooms, where there is space for them."""
    walls = list(plan.walls)
    neighbours: list[Plan] = []
    for number, wall in enumerate(plan.walls):
        for door in wall.openings:
            if door.kind is OpeningKind.DOOR and rng.uniform() < 0.8:
                passage = replace(door, kind=OpeningKind.PASSAGE, deep=rng.uniform(0.09, 0.15))
                behind = _neighbour(rng, wall, passage)
                taken = np.array([*plan.parts, *(n.outline for n in neighbours)])
                if not overlap_any(behind.outline, taken):
                    openings = tuple(passage if o is door else o for o in wall.openings)
                    walls[number] = Wall(wall.start, wall.end, openings)
                    neighbours.append(behind)
    return replace(plan, walls=tuple(walls), neighbours=tuple(neighbours))


def _neighbour(rng: Rng, wall: Wall, passage: Opening) -> Plan:
    """A rectangular room or corridor behind a wall."""
    corridor = rng.uniform() < 0.4
    deep = rng.uniform(1.0, 1.7) if corridor else rng.uniform(2.2, 4.5)
    x0 = passage.left - rng.uniform(0.25, 2.5)
    x1 = passage.right + rng.uniform(0.25, 2.5)
    corners = wall.to_world(np.array(rectangle(x0, -passage.deep - deep, x1, -passage.deep)))
    ceiling = np.array([[0.0, 0.0, rng.uniform(2.25, 2.9)]])
    bare = _walled(Shape(corners, corners[None]), (ceiling,))
    kinds: list[list[OpeningKind]] = [[], [], [], []]
    for side in (0, 1, 3):
        if bare.walls[side].length > 1.5 and rng.uniform() < 0.45:
            kinds[side].append(OpeningKind.DOOR if rng.uniform() < 0.4 else OpeningKind.WINDOW)
    plan = _opened(rng, bare, _high_stretches(bare), kinds)
    back = replace(passage, left=x1 - passage.right, right=x1 - passage.left)
    facing = Wall(plan.walls[2].start, plan.walls[2].end, (back,))
    return replace(plan, walls=(*plan.walls[:2], facing, plan.walls[3]))


def overlaps(a: Array, b: Array) -> bool:
    """Whether two convex polygons (n, 2) overlap."""
    return bool(overlap_any(a, b[None]))


def overlap_any(polygon: Array, others: Array) -> bool:
    """Whether a convex polygon (n, 2) overlaps one of (k, m, 2) others (separating axes)."""
    own, theirs = _normals(polygon), _normals(others)
    apart = _apart(polygon @ own.T, others @ own.T)
    across = theirs.swapaxes(-1, -2)
    return bool((~apart & ~_apart(polygon @ across, others @ across)).any())


def _normals(polygons: Array) -> Array:
    following = np.concatenate([polygons[..., 1:, :], polygons[..., :1, :]], axis=-2)
    return np.asarray((following - polygons)[..., ::-1] * [1.0, -1.0])


def _apart(a: Array, b: Array) -> BoolArray:
    """Whether along some axis the points (..., n, axes) of a and of b do not meet."""
    gap = (a.max(-2) <= b.min(-2)) | (b.max(-2) <= a.min(-2))
    return np.asarray(gap.any(axis=-1))
