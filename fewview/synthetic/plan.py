"""The shell of a room: an outline, walls with doors and windows, floor and ceiling."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np

from fewview.synthetic import prints, textures
from fewview.synthetic.classes import Surface
from fewview.synthetic.items import Patches, placement
from fewview.synthetic.surfaces import Patch, box, box_corners, covered, labelled, moved, printed
from fewview.synthetic.textures import Rng, Texture, brown, muted, plain
from fewview.types import Array, BoolArray


class OpeningKind(StrEnum):
    """What is inset in a wall."""

    DOOR = "door"
    WINDOW = "window"


@dataclass(frozen=True)
class Opening:
    """A rectangle of a wall: ``left``..``right`` along it, ``sill``..``top`` above the floor."""

    kind: OpeningKind
    left: float
    right: float
    sill: float
    top: float


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


@dataclass(frozen=True)
class Plan:
    """A floor plan.

    Attributes:
        outline: (n, 2) corners, counter-clockwise, metres.
        parts: (k, 4, 2) convex quadrilaterals that tile it.
        height: of the ceiling.
        walls: one per side of the outline.
    """

    outline: Array
    parts: Array
    height: float
    walls: tuple[Wall, ...]

    def contains(self, points: Array) -> BoolArray:
        """Which of (n, 2) points lie inside the outline (even-odd rule)."""
        a, b = self.outline, np.roll(self.outline, -1, axis=0)
        x, y = points[:, :1], points[:, 1:]
        crosses = (a[:, 1] > y) != (b[:, 1] > y)
        rise = np.where(a[:, 1] == b[:, 1], 1.0, b[:, 1] - a[:, 1])
        left = x < a[:, 0] + (y - a[:, 1]) * (b[:, 0] - a[:, 0]) / rise
        return np.asarray((crosses & left).sum(axis=1) % 2 == 1)


def make_plan(rng: Rng) -> Plan:
    """A box or an L, turned by any angle, often with one wall that is slanted."""
    w, d = rng.uniform(3.6, 6.2), rng.uniform(3.2, 5.2)
    if rng.uniform() < 0.4:
        x, y = w * rng.uniform(0.45, 0.65), d * rng.uniform(0.45, 0.65)
        w, d = w + 0.8, d + 0.8
        outline = np.array([[0, 0], [w, 0], [w, y], [x, y], [x, d], [0, d]])
        parts = [[0, 1, 2, 3], [0, 3, 4, 5]]
    else:
        outline = np.array([[0, 0], [w, 0], [w, d], [0, d]])
        parts = [[0, 1, 2, 3]]
    outline = outline + rng.normal(0, 0.01, outline.shape)
    if rng.uniform() < 0.5:
        outline[1, 0] -= rng.uniform(0.1, 0.7)
    yaw = placement(0, 0, 0, rng.uniform(-np.pi, np.pi))[:2, :2]
    outline = (outline - outline.mean(axis=0)) @ yaw.T
    height = rng.uniform(2.3, 3.0)
    ends = np.roll(outline, -1, axis=0)
    lengths = np.linalg.norm(ends - outline, axis=1)
    kinds = _opening_kinds(rng, lengths)
    walls = tuple(
        Wall(a, b, _openings(rng, float(n), k))
        for a, b, n, k in zip(outline, ends, lengths, kinds, strict=True)
    )
    return Plan(outline, outline[parts], height, walls)


def _opening_kinds(rng: Rng, lengths: Array) -> list[list[OpeningKind]]:
    kinds: list[list[OpeningKind]] = [[] for _ in lengths]
    order = rng.permutation(np.flatnonzero(lengths > 1.8))
    kinds[order[0]].append(OpeningKind.DOOR)
    for wall in order[1 : 1 + rng.integers(1, 3)]:
        kinds[wall] += [OpeningKind.WINDOW] * int(
            rng.integers(1, 1 + max(1, int(lengths[wall] / 2.2)))
        )
    if rng.uniform() < 0.3:
        kinds[order[-1]].append(OpeningKind.DOOR)
    return kinds


def _openings(rng: Rng, length: float, kinds: list[OpeningKind]) -> tuple[Opening, ...]:
    out = []
    slot = length / max(1, len(kinds))
    for i, kind in enumerate(kinds):
        door = kind is OpeningKind.DOOR
        width = 0.9 if door else min(rng.uniform(0.9, 1.8), slot - 0.6)
        left = slot * i + rng.uniform(0.25, max(0.26, slot - width - 0.25))
        sill, top = (0.0, 2.02) if door else (rng.uniform(0.8, 1.0), rng.uniform(1.95, 2.15))
        out.append(Opening(kind, left, left + width, sill, top))
    return tuple(out)


def shell(plan: Plan, rng: Rng) -> Patches:
    """All surfaces of floor, ceiling, walls, doors, windows and skirting."""
    tone = np.full(3, rng.uniform(175, 240)) * rng.uniform(0.9, 1.0, 3)
    accent = int(rng.integers(len(plan.walls))) if rng.uniform() < 0.6 else -1
    skirting = plain(rng, np.full(3, rng.uniform(120, 235)) if rng.uniform() < 0.7 else brown(rng))
    out = [
        *labelled([_level(plan, 0.0, _floor(rng, plan))], Surface.FLOOR),
        *labelled([_level(plan, plan.height, _ceiling(rng, plan))], Surface.CEILING),
    ]
    for number, wall in enumerate(plan.walls):
        size = (wall.length, plan.height)
        texture = _accent(rng, size) if number == accent else textures.paint(rng, size, tone)
        parts = [_wall_face(wall, plan.height, texture)]
        for opening in wall.openings:
            parts += _inset(opening, rng)
        parts += _skirting(wall, skirting, rng)
        out += labelled(moved(parts, wall.world_T_wall), Surface.WALL)
    return tuple(out)


def _extent(plan: Plan) -> tuple[float, float]:
    size = np.ptp(plan.outline, axis=0)
    return float(size[0]), float(size[1])


def _floor(rng: Rng, plan: Plan) -> Texture:
    makers = (textures.parquet, textures.carpet, textures.carpet, textures.tiles)
    make = makers[rng.integers(len(makers))]
    base = brown(rng) if make is textures.parquet else muted(rng)
    return make(rng, _extent(plan), base)


def _ceiling(rng: Rng, plan: Plan) -> Texture:
    base = np.full(3, rng.uniform(215, 240))
    make = textures.paint if rng.uniform() < 0.75 else textures.tiles
    return make(rng, _extent(plan), base, 0.01)


def _accent(rng: Rng, size: tuple[float, float]) -> Texture:
    kind = rng.integers(4)
    if kind == 0:
        return textures.brick(rng, size, np.array([160.0, 85, 65]) * rng.uniform(0.7, 1.3))
    if kind == 1:
        return textures.wood(rng, size, brown(rng), 0.006)
    if kind == 2:
        return textures.paint(rng, size, muted(rng))
    return textures.wallpaper(rng, size, muted(rng) * 0.4 + 130)


def _level(plan: Plan, z: float, texture: Texture) -> Patch:
    order = [0, 1, 2, 3] if z == 0.0 else [0, 3, 2, 1]
    corners = np.concatenate([plan.parts, np.full((*plan.parts.shape[:2], 1), z)], axis=-1)[
        :, order
    ]
    uv = (corners[..., :2] - plan.outline.min(axis=0)) / texture.texel_m
    return Patch(corners, uv, texture)


def _wall_face(wall: Wall, height: float, texture: Texture) -> Patch:
    cuts = [0.0, *(x for o in wall.openings for x in (o.left, o.right)), wall.length]
    holes: list[Opening | None] = [None]
    for opening in wall.openings:
        holes += [opening, None]
    rectangles = []
    for left, right, hole in zip(cuts[:-1], cuts[1:], holes, strict=True):
        spans = [(0.0, height)] if hole is None else [(0.0, hole.sill), (hole.top, height)]
        rectangles += [(left, right, low, high) for low, high in spans if high > low]
    corners = np.array(
        [[[x1, 0, z0], [x0, 0, z0], [x0, 0, z1], [x1, 0, z1]] for x0, x1, z0, z1 in rectangles],
        dtype=np.float64,
    )
    return Patch(
        corners, (np.array([wall.length, height]) - corners[..., [0, 2]]) / texture.texel_m, texture
    )


def _inset(opening: Opening, rng: Rng) -> Patches:
    """A door leaf or window pane some way into the wall, its reveals and its frame."""
    door = opening.kind is OpeningKind.DOOR
    width, height = opening.right - opening.left, opening.top - opening.sill
    deep = 0.04 if door else 0.12
    middle = 0.5 * (opening.left + opening.right)
    tone = brown(rng) if rng.uniform() < 0.4 else np.full(3, rng.uniform(150, 235))
    size = (width, height)
    picture = prints.front(rng, size, tone, 1, 1) if door else prints.outside(rng, size)
    hollow = box_corners((width, deep, height), (middle, -0.5 * deep, opening.sill))
    trim, edge = plain(rng, tone), 0.07
    bars = [
        ((edge, 0.02, height), (opening.left - 0.5 * edge, 0.01, opening.sill)),
        ((edge, 0.02, height), (opening.right + 0.5 * edge, 0.01, opening.sill)),
        ((width + 2 * edge, 0.02, edge), (middle, 0.01, opening.top)),
    ]
    if not door:
        bars.append(((width + 2 * edge, 0.1, 0.03), (middle, 0.05, opening.sill - 0.03)))
    pane = hollow[0][[1, 0, 3, 2]]
    parts = (
        printed(pane, picture),
        covered(hollow[[1, 3, 4, 5]][:, ::-1], trim, rng),
        *(box(bar_size, at, trim, rng) for bar_size, at in bars),
    )
    return labelled(parts, Surface.DOOR if door else Surface.WINDOW)


def _skirting(wall: Wall, texture: Texture, rng: Rng) -> Patches:
    doors = [o for o in wall.openings if o.kind is OpeningKind.DOOR]
    cuts = [0.0, *(x for o in doors for x in (o.left - 0.07, o.right + 0.07)), wall.length]
    pairs = zip(cuts[::2], cuts[1::2], strict=True)
    return tuple(
        box((right - left, 0.015, 0.08), (0.5 * (left + right), 0.0075, 0), texture, rng)
        for left, right in pairs
        if right > left
    )
