"""What hangs on walls: things centred in x that stand out from y = 0 towards +y."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fewview.synthetic import items, prints, textures
from fewview.synthetic.items import Patches, placement
from fewview.synthetic.surfaces import box, box_corners, faced_box, moved, printed
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
