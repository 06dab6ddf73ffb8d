"""The surfaces of a plan: floors, ceilings, walls, doors, windows, passages, skirting."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from fewview.synthetic import ceilings, prints, textures
from fewview.synthetic.classes import PlaneKind, Surface
from fewview.synthetic.items import Patches
from fewview.synthetic.plan import Opening, OpeningKind, Plan, Wall
from fewview.synthetic.surfaces import (
    Patch,
    box,
    box_corners,
    covered,
    labelled,
    moved,
    printed,
)
from fewview.synthetic.textures import Rng, Texture, brown, muted, plain
from fewview.types import Array

_SAME_COSINE, _SAME_M = float(np.cos(np.radians(1.0))), 0.01
_STEP_M = 0.005
_LISTED_M = 0.4


@dataclass
class Structure:
    """The planes that hold rooms together.

    Attributes:
        planes: (4,) each, normal into the room and offset, n . x = d.
        kinds: of the planes.
        of_room: for each room the numbers of its planes.
    """

    planes: list[Array] = field(default_factory=list)
    kinds: list[PlaneKind] = field(default_factory=list)
    of_room: list[set[int]] = field(default_factory=list)

    def number(self, kind: PlaneKind, normal: Array, point: Array, listed: bool = True) -> int:
        """The plane through a point, a new one unless there is one of the kind already.

        It counts as one of the last room's if it is ``listed``.
        """
        plane = np.append(normal, normal @ point)
        for number, known in enumerate(self.planes):
            near = abs(known[3] - plane[3]) < _SAME_M and known[:3] @ normal > _SAME_COSINE
            if self.kinds[number] is kind and near:
                break
        else:
            number = len(self.planes)
            self.planes.append(plane)
            self.kinds.append(kind)
        if listed:
            self.of_room[-1].add(number)
        return number


def shell(plan: Plan, rng: Rng, structure: Structure) -> Patches:
    """All surfaces of a room and of those next door; their planes are added to ``structure``."""
    out: list[Patch] = []
    for room in plan.rooms:
        structure.of_room.append(set())
        out += _one_room(room, rng, structure, passages=room is plan)
    return tuple(out)


def _one_room(plan: Plan, rng: Rng, structure: Structure, passages: bool) -> list[Patch]:
    tone = np.full(3, rng.uniform(175, 240)) * rng.uniform(0.9, 1.0, 3)
    if rng.uniform() < 0.25:
        tone = 0.5 * tone + 0.5 * muted(rng)
    accent = int(rng.integers(len(plan.walls))) if rng.uniform() < 0.6 else -1
    skirting = plain(rng, np.full(3, rng.uniform(120, 235)) if rng.uniform() < 0.7 else brown(rng))
    paint = textures.paint(rng, (max(w.length for w in plan.walls), plan.height), tone)
    out = [*_floor(plan, rng, structure), *_ceiling(plan, rng, structure), *_steps(plan, paint)]
    for number, wall in enumerate(plan.walls):
        texture = _accent(rng, (wall.length, plan.height)) if number == accent else paint
        normal, start = wall.world_T_wall[:3, 1], wall.world_T_wall[:3, 3]
        plane = structure.number(PlaneKind.WALL, normal, start, wall.length > _LISTED_M)
        parts = [replace(_wall_face(plan, wall, texture), plane=plane)]
        for opening in wall.openings:
            if opening.kind is not OpeningKind.PASSAGE:
                parts += _inset(opening, rng)
            elif passages:
                parts += _passage(opening, rng)
        parts += _skirting(wall, skirting, rng)
        out += labelled(moved(parts, wall.world_T_wall), Surface.WALL)
    return out


def _extent(plan: Plan) -> tuple[float, float]:
    size = np.ptp(plan.outline, axis=0)
    return float(size[0]), float(size[1])


def _floor(plan: Plan, rng: Rng, structure: Structure) -> Patches:
    makers = (textures.parquet, textures.carpet, textures.carpet, textures.tiles)
    make = makers[rng.integers(len(makers))]
    texture = make(rng, _extent(plan), brown(rng) if make is textures.parquet else muted(rng))
    corners = np.concatenate([plan.parts, np.zeros((*plan.parts.shape[:2], 1))], axis=-1)
    plane = structure.number(PlaneKind.FLOOR, np.array([0.0, 0, 1]), np.zeros(3))
    face = replace(_from_above(plan, corners, texture), plane=plane)
    return labelled([face], Surface.FLOOR)


def _ceiling(plan: Plan, rng: Rng, structure: Structure) -> Patches:
    base = np.full(3, rng.uniform(215, 240))
    make = textures.paint if rng.uniform() < 0.75 else textures.tiles
    texture = make(rng, _extent(plan), base, 0.01)
    out = []
    for planes, part in zip(plan.ceilings, plan.parts, strict=True):
        for number, corners in ceilings.faces(planes, part):
            normal = np.array([*planes[number, :2], -1.0])
            normal /= np.linalg.norm(normal)
            plane = structure.number(PlaneKind.CEILING, normal, corners[0, 0])
            out.append(replace(_from_above(plan, corners, texture), plane=plane))
    return labelled(out, Surface.CEILING)


def _from_above(plan: Plan, corners: Array, texture: Texture) -> Patch:
    uv = (corners[..., :2] - plan.outline.min(axis=0)) / texture.texel_m
    return Patch(corners, uv, texture)


def _accent(rng: Rng, size: tuple[float, float]) -> Texture:
    kind = rng.integers(4)
    if kind == 0:
        return textures.brick(rng, size, np.array([160.0, 85, 65]) * rng.uniform(0.7, 1.3))
    if kind == 1:
        return textures.wood(rng, size, brown(rng), 0.006)
    if kind == 2:
        return textures.paint(rng, size, muted(rng))
    return textures.wallpaper(rng, size, muted(rng) * 0.4 + 130)


def _steps(plan: Plan, texture: Texture) -> Patches:
    """Where a part's ceiling hangs lower than the main part's, the upright face between them."""
    high = plan.ceilings[0]
    out = []
    for planes, part in zip(plan.ceilings[1:], plan.parts[1:], strict=True):
        edges = zip(part, np.roll(part, -1, axis=0), strict=True)
        for a, b in edges:
            middle, shift = 0.5 * (a + b), 0.02 * np.array([b[1] - a[1], a[0] - b[0]])
            if not plan.contains((middle + shift)[None])[0]:
                continue
            low, top = (float(ceilings.heights(p, middle)) for p in (planes, high))
            if top - low > _STEP_M:
                face = np.array([[*a, low], [*b, low], [*b, top], [*a, top]])
                along = float(np.linalg.norm(b - a))
                uv = np.array([[0, top - low], [along, top - low], [along, 0], [0, 0]])
                out.append(Patch(face[None], uv[None] / texture.texel_m, texture))
    return labelled(out, Surface.WALL)


def _wall_face(plan: Plan, wall: Wall, texture: Texture) -> Patch:
    corners = []
    for left, right in pairwise(_cuts(plan, wall)):
        middle = 0.5 * (left + right)
        hole = next((o for o in wall.openings if o.left < middle < o.right), None)
        inset = np.array([[left + 1e-6, 1e-6], [right - 1e-6, 1e-6]])
        top = plan.height_at(wall.to_world(inset))
        spans = [(np.zeros(2), top)]
        if hole is not None:
            spans = [(np.zeros(2), np.full(2, hole.sill)), (np.full(2, hole.top), top)]
        for low, high in spans:
            if (high > low).any():
                face = [[right, low[1]], [left, low[0]], [left, high[0]], [right, high[1]]]
                corners.append(np.insert(np.array(face), 1, 0.0, axis=1))
    quads = np.array(corners)
    uv = (np.array([wall.length, plan.height]) - quads[..., [0, 2]]) / texture.texel_m
    return Patch(quads, uv, texture)


def _cuts(plan: Plan, wall: Wall) -> list[float]:
    """Places along a wall where an opening ends or the ceiling breaks."""
    cuts = [0.0, wall.length, *(x for o in wall.openings for x in (o.left, o.right))]
    for planes, part in zip(plan.ceilings, plan.parts, strict=True):
        cuts += [share * wall.length for share in ceilings.breaks(planes, wall.start, wall.end)]
        along, across = wall.to_wall(part).T
        cuts += [float(x) for x in along[np.abs(across) < 0.01] if 0.01 < x < wall.length - 0.01]
    ordered = np.sort(cuts)
    return [float(x) for x in ordered[np.append(True, np.diff(ordered) > 1e-4)]]


def _inset(opening: Opening, rng: Rng) -> Patches:
    """A door leaf or window pane some way into the wall, its reveals and its frame."""
    door = opening.kind is OpeningKind.DOOR
    width, height = opening.right - opening.left, opening.top - opening.sill
    deep, middle = opening.deep, 0.5 * (opening.left + opening.right)
    tone = brown(rng) if rng.uniform() < 0.4 else np.full(3, rng.uniform(150, 235))
    size = (width, height)
    picture = prints.front(rng, size, tone, 1, 1) if door else prints.outside(rng, size)
    hollow = box_corners((width, deep, height), (middle, -0.5 * deep, opening.sill))
    trim = plain(rng, tone)
    parts = (
        printed(hollow[0][[1, 0, 3, 2]], picture),
        covered(hollow[[1, 3, 4, 5]][:, ::-1], trim, rng),
        *_frame(opening, trim, rng, 0.0),
    )
    if not door and opening.sill > 0.2:
        board = box((width + 0.14, 0.1, 0.03), (middle, 0.05, opening.sill - 0.03), trim, rng)
        parts = (*parts, board)
    return labelled(parts, Surface.DOOR if door else Surface.WINDOW)


def _frame(opening: Opening, trim: Texture, rng: Rng, front: float) -> Patches:
    """Bars left, right and above an opening that stand out from y = ``front``."""
    width, height, edge = opening.right - opening.left, opening.top - opening.sill, 0.07
    y, middle = front + 0.01, 0.5 * (opening.left + opening.right)
    upright = (edge, 0.02, height)
    return (
        box(upright, (opening.left - 0.5 * edge, y, opening.sill), trim, rng),
        box(upright, (opening.right + 0.5 * edge, y, opening.sill), trim, rng),
        box((width + 2 * edge, 0.02, edge), (middle, y, opening.top), trim, rng),
    )


def _passage(opening: Opening, rng: Rng) -> Patches:
    """The reveals between two rooms, frames on both sides, and often an open door."""
    width, middle = opening.right - opening.left, 0.5 * (opening.left + opening.right)
    tone = brown(rng) if rng.uniform() < 0.4 else np.full(3, rng.uniform(150, 235))
    trim = plain(rng, tone)
    hollow = box_corners((width, opening.deep, opening.top), (middle, -0.5 * opening.deep, 0.0))
    parts = [
        covered(hollow[[1, 3, 4, 5]][:, ::-1], trim, rng),
        *_frame(opening, trim, rng, 0.0),
        *_frame(opening, trim, rng, -opening.deep - 0.02),
    ]
    if rng.uniform() < 0.6:
        parts += _leaf(opening, tone, trim, rng)
    return labelled(parts, Surface.DOOR)


def _leaf(opening: Opening, tone: Array, trim: Texture, rng: Rng) -> Patches:
    """A door that has been swung into the room next door."""
    width = opening.right - opening.left - 0.02
    face = prints.front(rng, (width, opening.top), tone, 1, 1)
    faces = box_corners((width, 0.04, opening.top - 0.02), (0.5 * width, 0.0, 0.01))
    slab = (
        covered(faces[[1, 3, 4, 5]], trim, rng),
        printed(faces[0], face),
        printed(faces[2], face),
    )
    angle = np.radians(rng.uniform(70, 95))
    hinge = np.eye(4)
    hinge[:2, :2] = [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
    hinge[:2, 3] = opening.left + 0.03, -opening.deep - 0.03
    return moved(slab, hinge)


def _skirting(wall: Wall, texture: Texture, rng: Rng) -> Patches:
    gaps = [o for o in wall.openings if o.sill < 0.1]
    cuts = [0.0, *(x for o in gaps for x in (o.left - 0.07, o.right + 0.07)), wall.length]
    pairs = zip(cuts[::2], cuts[1::2], strict=True)
    return tuple(
        box((right - left, 0.015, 0.08), (0.5 * (left + right), 0.0075, 0), texture, rng)
        for left, right in pairs
        if right > left
    )
