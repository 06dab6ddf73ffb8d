"""Shelves, cupboards, wardrobes, kitchens."""

from __future__ import annotations

import numpy as np

from fewview.synthetic import items, kinds, prints, textures
from fewview.synthetic.classes import Surface
from fewview.synthetic.furniture import Piece, piece, timber_of
from fewview.synthetic.items import clutter, placement
from fewview.synthetic.surfaces import (
    Patch,
    as_part,
    box,
    box_corners,
    boxes,
    covered,
    faced_box,
    labelled,
    moved,
    printed,
)  # fmt: skip
from fewview.synthetic.textures import Rng, brown, muted, plain, vivid


def bookshelf(rng: Rng) -> Piece:
    """Open shelves with books, boxes and odd things."""
    w, d, h = rng.uniform(0.6, 1.4), rng.uniform(0.26, 0.34), rng.uniform(1.1, 2.1)
    timber = timber_of(rng)
    shelves = int(rng.integers(3, 6)) if h > 1.5 else 3
    step = (h - 0.1) / shelves
    boards = [((0.025, d, h), (x, 0.0, 0.0)) for x in (-0.5 * w, 0.5 * w)]
    boards.append(((w, 0.012, h), (0.0, 0.006 - 0.5 * d, 0.0)))
    parts: list[Patch] = []
    for shelf in range(shelves + 1):
        z = 0.06 + shelf * step
        boards.append(((w, d, 0.02), (0.0, 0.0, z - 0.02)))
        if shelf < shelves:
            row = (
                items.book_row(
                    rng, (w - 0.04) * rng.uniform(0.5, 1), d - 0.02, min(step - 0.04, 0.3)
                )
                if rng.uniform() < 0.75
                else clutter(rng, w - 0.1, 0.26, 0, 0.7)
            )
            parts += moved(row, placement(0, 0, z))
    whole = as_part(kinds.BOOKSHELF, [boxes(boards, timber, rng), *parts])
    return piece("bookshelf", whole, Surface.CABINET)


def cupboard(rng: Rng) -> Piece:
    """A sideboard with doors or drawers and things on top."""
    w, d, h = rng.uniform(0.7, 1.7), rng.uniform(0.35, 0.5), rng.uniform(0.6, 1.0)
    timber = timber_of(rng, 1.2)
    columns, rows = max(1, round(w / rng.uniform(0.4, 0.7))), int(rng.integers(1, 4))
    face = prints.front(
        rng, (w, h), brown(rng) if rng.uniform() < 0.5 else muted(rng), columns, rows
    )
    parts = (
        *as_part(kinds.CUPBOARD, faced_box((w, d, h), (0, 0, 0), timber, face, rng)),
        *clutter(rng, w - 0.1, d - 0.08, h),
    )
    return piece("cupboard", parts, Surface.CABINET)


def wardrobe(rng: Rng) -> Piece:
    """A tall cupboard."""
    w, d, h = rng.uniform(0.8, 1.8), rng.uniform(0.5, 0.62), rng.uniform(1.8, 2.15)
    face = prints.front(rng, (w, h), muted(rng), round(w / 0.5), int(rng.integers(1, 3)))
    body = faced_box((w, d, h), (0, 0, 0), timber_of(rng, 1.5), face, rng)
    return piece("wardrobe", as_part(kinds.WARDROBE, body), Surface.CABINET)


def kitchen(rng: Rng) -> Piece:
    """Base units under a counter, tiles behind, wall units above."""
    w, d = rng.uniform(1.8, 3.0), 0.6
    doors, tone = round(w / 0.55), vivid(rng) if rng.uniform() < 0.3 else muted(rng)
    body = plain(rng, tone)
    low, high = (prints.front(rng, size, tone, doors, 1) for size in ((w, 0.75), (w, 0.65)))
    splash = textures.tiles(rng, (w, 0.6), muted(rng) * 0.4 + 140)
    top = textures.stone(rng, (1.5, 0.7), np.full(3, rng.uniform(40, 190)))
    parts = (
        *faced_box((w, d - 0.06, 0.75), (0, -0.03, 0.1), body, low, rng),
        box((w, d - 0.12, 0.1), (0, -0.06, 0), plain(rng, np.full(3, 60.0)), rng),
        box((w, d, 0.04), (0, 0, 0.85), top, rng),
        printed(box_corners((w, 0.01, 0.55), (0, 0.005 - 0.5 * d, 0.89))[2], splash),
        *faced_box((w, 0.34, 0.65), (0, 0.17 - 0.5 * d, 1.44), body, high, rng),
        *clutter(rng, w - 0.1, d - 0.1, 0.89),
    )
    return piece("kitchen", parts, Surface.CABINET)


def media(rng: Rng) -> Piece:
    """A low board with a television."""
    w, d, h = rng.uniform(1.1, 1.8), 0.4, rng.uniform(0.4, 0.55)
    face = prints.front(rng, (w, h), muted(rng), 3, 1)
    size = (rng.uniform(0.8, min(w, 1.3)), 0.05)
    case = box_corners((*size, 0.58 * size[0]), (0, -0.05, h + 0.06))
    black = plain(rng, np.full(3, 30.0))
    screen = (
        covered(np.delete(case, 2, axis=0), black, rng),
        printed(case[2], prints.screen(rng, (size[0], 0.58 * size[0]), 0.004)),
        box((0.35, 0.2, 0.06), (0, -0.05, h), black, rng),
    )
    parts = (
        *as_part(kinds.CUPBOARD, faced_box((w, d, h), (0, 0, 0), timber_of(rng), face, rng)),
        *labelled(screen, Surface.OTHER),
        *moved(clutter(rng, w - 0.05, 0.1, h, 0.35), placement(0, 0.13, 0)),
    )
    return piece("media", parts, Surface.CABINET)


def fridge(rng: Rng) -> Piece:
    """A refrigerator or a tall unit with an oven."""
    w, d, h = rng.uniform(0.55, 0.7), rng.uniform(0.58, 0.68), rng.uniform(1.3, 2.05)
    tone = np.full(3, rng.uniform(60, 240))
    face = prints.front(rng, (w, h), tone, 1, int(rng.integers(1, 4)))
    body = faced_box((w, d, h), (0, 0, 0), plain(rng, tone), face, rng)
    return piece("fridge", as_part(kinds.FRIDGE, body), Surface.CABINET)
