"""Procedural furniture. A piece stands on z = 0, centred on its footprint, its front towards +y."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fewview.synthetic import items, prints, textures
from fewview.synthetic.classes import Surface
from fewview.synthetic.items import Patches, clutter, placement
from fewview.synthetic.surfaces import (
    Patch,
    box,
    box_corners,
    covered,
    faced_box,
    labelled,
    lathed,
    moved,
    printed,
)
from fewview.synthetic.textures import Rng, Texture, brown, muted, plain, vivid


@dataclass(frozen=True)
class Piece:
    """A piece of furniture, or a group that stands together.

    Attributes:
        name: what it is.
        patches: its surfaces.
        size: (width, depth, height) of the box that holds it, metres.
    """

    name: str
    patches: Patches
    size: tuple[float, float, float]


def _piece(name: str, patches: Iterable[Patch], surface: Surface = Surface.OTHER) -> Piece:
    """Centre surfaces on their footprint, measure them and name those that have no name."""
    parts = labelled(patches, surface)
    points = np.concatenate([p.corners.reshape(-1, 3) for p in parts])
    low, high = points.min(axis=0), points.max(axis=0)
    width, depth, _ = high - low
    x, y, _ = -0.5 * (low + high)
    return Piece(name, moved(parts, placement(x, y, 0)), (width, depth, float(high[2])))


def _timber(rng: Rng, size_m: float = 0.9) -> Texture:
    if rng.uniform() < 0.75:
        return textures.wood(rng, (size_m, 0.7), brown(rng))
    return plain(rng, np.full(3, rng.uniform(170, 240)) if rng.uniform() < 0.6 else muted(rng))


def _legs(rng: Rng, w: float, d: float, h: float, texture: Texture, thick: float) -> Patches:
    x, y = 0.5 * w - 0.8 * thick, 0.5 * d - 0.8 * thick
    spots = ((-x, -y), (x, -y), (x, y), (-x, y))
    return tuple(box((thick, thick, h), (*spot, 0), texture, rng) for spot in spots)


def table(rng: Rng, w: float, d: float, h: float) -> Patches:
    """A top on four legs with things on it."""
    timber = _timber(rng, 1.2)
    top = box((w, d, 0.035), (0, 0, h - 0.035), timber, rng)
    legs = _legs(rng, w, d, h - 0.035, timber, rng.uniform(0.04, 0.08))
    return (top, *legs, *clutter(rng, w - 0.08, d - 0.08, h))


def chair(rng: Rng, timber: Texture, seat: Texture) -> Patches:
    """A chair of 0.45 x 0.48 m; the back, slatted, is at -y."""
    high = rng.uniform(0.85, 1.0)
    slats = tuple(
        box((0.40, 0.02, 0.05), (0, -0.21, z), timber, rng)
        for z in np.arange(0.55, high - 0.06, rng.uniform(0.08, 0.16))
    )
    posts = tuple(box((0.035, 0.035, high), (x, -0.21, 0), timber, rng) for x in (-0.2, 0.2))
    legs = tuple(box((0.035, 0.035, 0.42), (x, 0.2, 0), timber, rng) for x in (-0.2, 0.2))
    sitting = box((0.45, 0.45, 0.04), (0, 0, 0.42), seat, rng)
    return labelled((sitting, *posts, *legs, *slats), Surface.CHAIR)


def dining(rng: Rng) -> Piece:
    """A table with chairs along both sides."""
    w, d, h = rng.uniform(1.0, 1.9), rng.uniform(0.75, 0.95), rng.uniform(0.72, 0.77)
    timber = _timber(rng)
    seat = textures.fabric(rng, (0.6, 0.6), muted(rng))
    out = list(labelled(table(rng, w, d, h), Surface.TABLE))
    places = max(1, int((w - 0.2) / 0.6))
    for side, yaw in ((-1, 0.0), (1, np.pi)):
        for place in range(places):
            if rng.uniform() < 0.85:
                x = (w - 0.2) * ((place + 0.5) / places - 0.5)
                y = side * (0.5 * d + rng.uniform(0.12, 0.22))
                turn = yaw + rng.normal(0, 0.08)
                out += moved(chair(rng, timber, seat), placement(x, y, 0, turn))
    return _piece("dining", out, Surface.TABLE)


def desk(rng: Rng) -> Piece:
    """A desk against the wall with a screen, papers, drawers below and a chair."""
    w, d, h = rng.uniform(1.1, 1.7), rng.uniform(0.6, 0.75), 0.74
    timber = _timber(rng, 1.2)
    top = box((w, d, 0.03), (0, 0, h - 0.03), timber, rng)
    legs = _legs(rng, w, d, h - 0.03, plain(rng, muted(rng)), 0.04)
    front = prints.front(rng, (0.4, 0.6), muted(rng), 1, int(rng.integers(2, 5)))
    drawers = faced_box((0.4, d - 0.1, 0.6), (0.5 * w - 0.3, 0, 0), timber, front, rng)
    screen = moved(items.monitor(rng), placement(-0.12 * w, -0.08, h))
    side = 0.5 * w - 0.28
    things = moved(clutter(rng, 0.3, d - 0.06, h, 0.9), placement(side + 0.1, 0, 0))
    seat = textures.fabric(rng, (0.6, 0.6), muted(rng))
    sitter = moved(
        chair(rng, plain(rng, np.full(3, 50.0)), seat),
        placement(-0.12 * w, 0.5 * d + 0.18, 0, np.pi + rng.normal(0, 0.3)),
    )
    return _piece("desk", (top, *legs, *drawers, *screen, *things, *sitter), Surface.TABLE)


def sofa(rng: Rng) -> Piece:
    """Seat cushions between arms before a back, with throw pillows."""
    w, d, back = rng.uniform(1.4, 2.2), rng.uniform(0.8, 0.95), rng.uniform(0.7, 0.9)
    cloth = textures.fabric(rng, (1.2, 0.8), muted(rng))
    seats = int(w / 0.65)
    parts: list[Patch] = [
        box((w, d, 0.28), (0, 0, 0.06), cloth, rng),
        box((w, 0.2, back - 0.34), (0, 0.1 - 0.5 * d, 0.34), cloth, rng),
        *(box((0.16, d, 0.28), (x, 0, 0.34), cloth, rng) for x in (0.08 - 0.5 * w, 0.5 * w - 0.08)),
    ]
    each = (w - 0.34) / seats
    for seat in range(seats):
        x = each * (seat + 0.5 - 0.5 * seats)
        parts.append(box((each - 0.02, d - 0.25, 0.12), (x, 0.1, 0.34), cloth, rng))
        if rng.uniform() < 0.5:
            pillow = textures.fabric(rng, (0.45, 0.45), vivid(rng))
            at = placement(x, 0.27 - 0.5 * d, 0.46, rng.normal(0, 0.1))
            parts += moved([box((0.42, 0.12, 0.36), (0, 0, 0), pillow, rng)], at)
    return _piece("sofa", parts, Surface.SOFA)


def bookshelf(rng: Rng) -> Piece:
    """Open shelves with books, boxes and odd things."""
    w, d, h = rng.uniform(0.6, 1.4), rng.uniform(0.26, 0.34), rng.uniform(1.1, 2.1)
    timber = _timber(rng)
    parts: list[Patch] = [box((0.025, d, h), (x, 0, 0), timber, rng) for x in (-0.5 * w, 0.5 * w)]
    parts.append(box((w, 0.012, h), (0, 0.006 - 0.5 * d, 0), timber, rng))
    shelves = int(rng.integers(3, 6)) if h > 1.5 else 3
    step = (h - 0.1) / shelves
    for shelf in range(shelves + 1):
        z = 0.06 + shelf * step
        parts.append(box((w, d, 0.02), (0, 0, z - 0.02), timber, rng))
        if shelf < shelves:
            row = (
                items.book_row(
                    rng, (w - 0.04) * rng.uniform(0.5, 1), d - 0.02, min(step - 0.04, 0.3)
                )
                if rng.uniform() < 0.75
                else clutter(rng, w - 0.1, 0.26, 0, 0.7)
            )
            parts += moved(row, placement(0, 0, z))
    return _piece("bookshelf", parts, Surface.CABINET)


def cupboard(rng: Rng) -> Piece:
    """A sideboard with doors or drawers and things on top."""
    w, d, h = rng.uniform(0.7, 1.7), rng.uniform(0.35, 0.5), rng.uniform(0.6, 1.0)
    timber = _timber(rng, 1.2)
    columns, rows = max(1, round(w / rng.uniform(0.4, 0.7))), int(rng.integers(1, 4))
    face = prints.front(
        rng, (w, h), brown(rng) if rng.uniform() < 0.5 else muted(rng), columns, rows
    )
    parts = (
        *faced_box((w, d, h), (0, 0, 0), timber, face, rng),
        *clutter(rng, w - 0.1, d - 0.08, h),
    )
    return _piece("cupboard", parts, Surface.CABINET)


def wardrobe(rng: Rng) -> Piece:
    """A tall cupboard."""
    w, d, h = rng.uniform(0.8, 1.8), rng.uniform(0.5, 0.62), rng.uniform(1.8, 2.15)
    face = prints.front(rng, (w, h), muted(rng), round(w / 0.5), int(rng.integers(1, 3)))
    body = faced_box((w, d, h), (0, 0, 0), _timber(rng, 1.5), face, rng)
    return _piece("wardrobe", body, Surface.CABINET)


def bed(rng: Rng) -> Piece:
    """A bed with its headboard against the wall, and blanket and pillows."""
    w, d = rng.uniform(0.95, 1.8), rng.uniform(2.0, 2.15)
    timber, head = _timber(rng, 1.2), rng.uniform(0.75, 1.15)
    blanket = textures.fabric(rng, (2.0, 1.6), vivid(rng) * 0.5 + 100)
    sheet = textures.fabric(rng, (1.0, 1.0), np.full(3, rng.uniform(190, 235)))
    parts: list[Patch] = [
        box((w, d, 0.22), (0, 0, 0.08), timber, rng),
        box((w, 0.05, head), (0, 0.025 - 0.5 * d, 0), timber, rng),
        box((w - 0.04, d - 0.08, 0.2), (0, 0.02, 0.3), sheet, rng),
        box((w + 0.02, 0.62 * d, 0.25), (0, 0.18 * d, 0.27), blanket, rng),
    ]
    for pillow in range(1 if w < 1.2 else 2):
        x = 0.0 if w < 1.2 else (pillow - 0.5) * 0.8
        at = placement(x, 0.38 - 0.5 * d, 0.5, rng.normal(0, 0.1))
        parts += moved([box((0.6, 0.4, 0.12), (0, 0, 0), sheet, rng)], at)
    return _piece("bed", parts, Surface.BED)


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
    return _piece("kitchen", parts, Surface.CABINET)


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
        *faced_box((w, d, h), (0, 0, 0), _timber(rng), face, rng),
        *labelled(screen, Surface.OTHER),
        *moved(clutter(rng, w - 0.05, 0.1, h, 0.35), placement(0, 0.13, 0)),
    )
    return _piece("media", parts, Surface.CABINET)


def coffee_table(rng: Rng) -> Piece:
    """A low table."""
    w, d, h = rng.uniform(0.7, 1.2), rng.uniform(0.5, 0.7), rng.uniform(0.38, 0.48)
    return _piece("coffee table", table(rng, w, d, h), Surface.TABLE)


def armchair(rng: Rng) -> Piece:
    """A single upholstered seat."""
    cloth = textures.fabric(rng, (0.9, 0.8), vivid(rng) * 0.6 + 40)
    parts = (
        box((0.8, 0.75, 0.42), (0, 0, 0.03), cloth, rng),
        box((0.8, 0.18, 0.45), (0, -0.285, 0.45), cloth, rng),
        *(box((0.14, 0.57, 0.18), (x, 0.09, 0.45), cloth, rng) for x in (-0.33, 0.33)),
    )
    return _piece("armchair", parts, Surface.SOFA)


def floor_lamp(rng: Rng) -> Piece:
    """A tall lamp."""
    return _piece("lamp", items.table_lamp(rng, rng.uniform(1.4, 1.7), 0.14))


def floor_plant(rng: Rng) -> Piece:
    """A large plant."""
    height = rng.uniform(0.7, 1.5)
    return _piece("plant", items.plant(rng, height))


def cartons(rng: Rng) -> Piece:
    """Moving boxes on each other."""
    out: list[Patch] = []
    z, brownish = 0.0, np.array([180.0, 140, 95]) * rng.uniform(0.7, 1.1)
    card = textures.stone(rng, (0.5, 0.5), brownish)
    for _ in range(rng.integers(1, 4)):
        size = (rng.uniform(0.35, 0.5), rng.uniform(0.3, 0.4), rng.uniform(0.2, 0.35))
        label = prints.poster(rng, (0.3, 0.2))
        turned = placement(0, 0, z, rng.normal(0, 0.12))
        out += moved(faced_box(size, (0, 0, 0), card, label, rng), turned)
        z += size[2]
    return _piece("cartons", out)


def waste_bin(rng: Rng) -> Piece:
    """A waste-paper bin."""
    profile = [(0.12, 0.0), (0.15, 0.32)]
    return _piece("bin", [lathed(profile, (0, 0, 0), plain(rng, muted(rng)))])
