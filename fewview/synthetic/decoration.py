"""What hangs on walls and at windows."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from fewview.synthetic import items, prints, textures
from fewview.synthetic.classes import Surface
from fewview.synthetic.furnish import Furnishing
from fewview.synthetic.items import Patches, placement
from fewview.synthetic.plan import Opening, OpeningKind, Wall
from fewview.synthetic.surfaces import (
    Patch,
    box,
    box_corners,
    boxes,
    faced_box,
    labelled,
    moved,
    printed,
)
from fewview.synthetic.textures import Rng, Texture, muted, plain, vivid


def _framed(rng: Rng, size: tuple[float, float], picture: Texture) -> Patches:
    tone = vivid(rng) if rng.uniform() < 0.3 else np.full(3, rng.uniform(20, 235))
    return faced_box((size[0], 0.02, size[1]), (0, 0.01, 0), plain(rng, tone), picture, rng)


def _shelf(rng: Rng, size: tuple[float, float]) -> Patches:
    timber = textures.wood(rng, (1.2, 0.3), muted(rng))
    plank = box((size[0], 0.22, 0.025), (0, 0.11, 0), timber, rng)
    row = items.book_row(rng, size[0] * rng.uniform(0.4, 0.95), 0.2, size[1] - 0.03)
    return plank, *moved(row, placement(0, 0.11, 0.025))


def _notes(rng: Rng, size: tuple[float, float]) -> Patches:
    count = int(size[0] / 0.25)
    spots = [(i - 0.5 * count + 0.5) * 0.25 for i in range(count)]
    faces = [box_corners((0.21, 0.004, 0.297), (x, 0.002, 0))[2] for x in spots]
    return tuple(printed(face, prints.page(rng, (0.21, 0.297))) for face in faces)


def _device(rng: Rng, size: tuple[float, float]) -> Patches:
    tone = np.full(3, rng.uniform(60, 240))
    body = (size[0], rng.uniform(0.01, 0.07), size[1])
    face = prints.front(rng, size, tone, int(rng.integers(1, 4)), int(rng.integers(1, 4)))
    return faced_box(body, (0, 0.5 * body[1], 0), plain(rng, tone), face, rng)


def _radiator(rng: Rng, size: tuple[float, float]) -> Patches:
    tone = np.full(3, rng.uniform(190, 245))
    ribs = prints.front(rng, size, tone, int(size[0] / 0.06), 1)
    return faced_box((size[0], 0.08, size[1]), (0, 0.06, 0), plain(rng, tone), ribs, rng)


@dataclass(frozen=True)
class Hanging:
    """Something for a wall: ranges of its size, and how to make it, standing out towards +y."""

    make: Callable[[Rng, tuple[float, float]], Patches]
    width: tuple[float, float]
    height: tuple[float, float]


_POSTER = Hanging(lambda rng, s: _framed(rng, s, prints.poster(rng, s)), (0.3, 0.85), (0.3, 0.85))
_PHOTO = Hanging(lambda rng, s: _framed(rng, s, prints.photo(rng, s)), (0.3, 0.85), (0.3, 0.85))
HANGING = (
    *(_POSTER, _POSTER, _PHOTO, _PHOTO),
    Hanging(lambda rng, s: _framed(rng, s, prints.whiteboard(rng, s)), (0.9, 1.6), (0.8, 1.0)),
    Hanging(lambda rng, s: _framed(rng, s, prints.screen(rng, s)), (0.9, 1.1), (0.55, 0.62)),
    Hanging(_shelf, (0.5, 1.1), (0.3, 0.3)),
    Hanging(_notes, (0.3, 0.9), (0.3, 0.3)),
    Hanging(_device, (0.08, 0.3), (0.08, 0.3)),
)

_OCCUPIED = tuple[float, float, float, float]


def decorate(room: Furnishing) -> Patches:
    """Curtains and radiators at the windows, pictures, shelves and the like on free walls."""
    density = room.rng.uniform(0.3, 5.0)
    out: list[Patch] = []
    for wall in room.plan.walls:
        things = [*_window_dressing(room, wall), *_hung(room, wall, density)]
        out += moved(things, wall.world_T_wall)
    return labelled(out, Surface.OTHER)


def _window_dressing(room: Furnishing, wall: Wall) -> Patches:
    rng, out = room.rng, []
    for o in wall.openings:
        if o.kind is not OpeningKind.WINDOW:
            continue
        if rng.uniform() < 0.5:
            cloth = textures.fabric(rng, (0.6, 1.4), muted(rng))
            low = 0.02 if rng.uniform() < 0.3 else max(0.02, o.sill - 0.05)
            size = (rng.uniform(0.2, 0.4), 0.05, o.top + 0.06 - low)
            spots = [(x, 0.14, low) for x in (o.left - 0.08, o.right + 0.08)]
            out.append(boxes([(size, spot) for spot in spots], cloth, rng))
        flat = (0.8 * (o.right - o.left), 0.7 * o.sill)
        middle = 0.5 * (o.left + o.right)
        free = not _meets(_behind(room, wall), (o.left, o.right, 0.0, o.sill))
        if o.sill > 0.5 and free and rng.uniform() < 0.6:
            out += moved(_radiator(rng, flat), placement(middle, 0, 0.12))
    return tuple(out)


def _hung(room: Furnishing, wall: Wall, density: float) -> Patches:
    rng = room.rng
    taken = [_surround(o) for o in wall.openings] + _behind(room, wall)
    x = np.array([[0.05, 0.01], [wall.length - 0.05, 0.01]])
    highest = float(room.plan.height_at(wall.to_world(x)).min()) - 0.1
    out: list[Patch] = []
    for _ in range(int(density * wall.length)):
        kind = HANGING[rng.integers(len(HANGING))]
        width, height = rng.uniform(*kind.width), rng.uniform(*kind.height)
        if wall.length < width + 0.3:
            continue
        along = rng.uniform(0.5 * width + 0.1, wall.length - 0.5 * width - 0.1)
        low = rng.uniform(0.9, max(0.95, 2.1 - height))
        place = (along - 0.5 * width - 0.06, along + 0.5 * width + 0.06, low, low + height)
        if low + height < highest and not _meets(taken, place):
            taken.append((*place[:2], low - 0.06, low + height + 0.06))
            out += moved(kind.make(rng, (width, height)), placement(along, 0, low))
    return tuple(out)


def _meets(taken: Iterable[_OCCUPIED], place: _OCCUPIED) -> bool:
    left, right, low, high = place
    return any(left < t[1] and right > t[0] and low < t[3] and high > t[2] for t in taken)


def _surround(opening: Opening) -> _OCCUPIED:
    side = 0.35 if opening.kind is OpeningKind.WINDOW else 0.12
    return opening.left - side, opening.right + side, opening.sill - 0.1, opening.top + 0.12


def _behind(room: Furnishing, wall: Wall) -> list[_OCCUPIED]:
    """What furniture close to a wall hides of it."""
    out = []
    for piece in room.standing:
        along, across = wall.to_wall(piece.footprint).T
        if across.min() < 0.3 and along.max() > 0 and along.min() < wall.length:
            out.append((float(along.min()), float(along.max()), 0.0, piece.height))
    return out
