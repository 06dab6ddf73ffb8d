"""Tables, desks, and what stands around them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fewview.synthetic import items, kinds, prints, textures
from fewview.synthetic.chairs import chair, office_chair
from fewview.synthetic.classes import Surface
from fewview.synthetic.furniture import Piece, beside, legs_of, piece, timber_of
from fewview.synthetic.items import Patches, clutter, placement
from fewview.synthetic.surfaces import (
    Patch,
    as_part,
    box,
    boxes,
    faced_box,
    labelled,
    lathed,
    moved,
)
from fewview.synthetic.textures import Rng, Texture, muted, plain

Seat = Callable[[Rng, Texture, Texture], Patches]


def table(rng: Rng, w: float, d: float, h: float, share: float = 0.7) -> Patches:
    """A top on four legs, a foot or panels, with things on a share of it."""
    timber, kind = timber_of(rng, 1.2), rng.uniform()
    top = box((w, d, 0.035), (0, 0, h - 0.035), timber, rng)
    under = legs_of(rng, w, d, h - 0.035, timber, rng.uniform(0.04, 0.08))
    if kind < 0.15:
        ends = [((0.04, 0.8 * d, h - 0.035), (x, 0.0, 0.0)) for x in (-0.42 * w, 0.42 * w)]
        under = boxes([*ends, ((0.84 * w, 0.03, 0.12), (0.0, 0.0, h - 0.3))], timber, rng)
    parts = as_part(kinds.TABLE, labelled((top, under), Surface.TABLE))
    return parts + clutter(rng, w - 0.08, d - 0.08, h, share)


def dining(rng: Rng) -> Piece:
    """A table with chairs along both sides."""
    w, d, h = rng.uniform(0.8, 1.9), rng.uniform(0.7, 0.95), rng.uniform(0.72, 0.77)
    out = [*table(rng, w, d, h, rng.uniform(0.1, 0.7)), *_sitters(rng, w, d, chair, 0.85)]
    return piece("dining", out, Surface.TABLE)


def round_table(rng: Rng) -> Piece:
    """A round table on one foot with chairs around it."""
    r, h, timber = rng.uniform(0.4, 0.65), rng.uniform(0.7, 0.76), timber_of(rng)
    body = lathed(
        [(0.6 * r, 0.0), (0.6 * r, 0.02), (0.05, 0.04), (0.05, h - 0.03), (r, h - 0.03), (r, h)],
        (0, 0, 0),
        timber,
    )
    stand = as_part(kinds.ROUND_TABLE, labelled([body], Surface.TABLE))
    parts = [*stand, *clutter(rng, r, r, h, 0.5)]
    fabric = textures.fabric(rng, (0.6, 0.6), muted(rng))
    count, first = int(rng.integers(2, 5)), rng.uniform(0, 2 * np.pi)
    for angle in first + 2 * np.pi * np.arange(count) / count:
        away = r + rng.uniform(0.05, 0.2)
        at = placement(away * np.cos(angle), away * np.sin(angle), 0, angle + 0.5 * np.pi)
        parts += moved(chair(rng, timber, fabric), at)
    return piece("round table", parts)


def conference(rng: Rng) -> Piece:
    """A long table with chairs on all sides."""
    w, d, h = rng.uniform(1.8, 3.4), rng.uniform(0.9, 1.3), rng.uniform(0.72, 0.76)
    seat = office_chair if rng.uniform() < 0.6 else chair
    out = [*table(rng, w, d, h, rng.uniform(0.05, 0.35)), *_sitters(rng, w, d, seat, 0.8)]
    if rng.uniform() < 0.5:
        timber, fabric = timber_of(rng), textures.fabric(rng, (0.6, 0.6), muted(rng))
        end = placement(0.5 * w + 0.15, 0, 0, 0.5 * np.pi + rng.normal(0, 0.2))
        out += moved(seat(rng, timber, fabric), end)
    return piece("conference", out, Surface.TABLE)


def _sitters(rng: Rng, w: float, d: float, seat: Seat, share: float) -> Patches:
    """Chairs along both long sides of a top, pushed in more or less."""
    timber, fabric = timber_of(rng), textures.fabric(rng, (0.6, 0.6), muted(rng))
    if rng.uniform() < 0.4:
        fabric = timber
    places = max(1, int((w - 0.1) / 0.62))
    out: list[Patch] = []
    for side, yaw in ((-1, 0.0), (1, np.pi)):
        for place in range(places):
            if rng.uniform() < share:
                x = (w - 0.1) * ((place + 0.5) / places - 0.5)
                y = side * (0.5 * d + rng.uniform(0.0, 0.3))
                out += moved(
                    seat(rng, timber, fabric), placement(x, y, 0, yaw + rng.normal(0, 0.15))
                )
    return tuple(out)


def desk(rng: Rng) -> Piece:
    """A desk against the wall with a screen or two, papers, drawers below and a chair."""
    w, d, h = rng.uniform(1.0, 1.8), rng.uniform(0.55, 0.8), rng.uniform(0.7, 0.76)
    timber = timber_of(rng, 1.2)
    parts = [
        box((w, d, 0.03), (0, 0, h - 0.03), timber, rng),
        legs_of(rng, w, d, h - 0.03, plain(rng, muted(rng)), 0.04),
    ]
    if rng.uniform() < 0.7:
        face = prints.front(rng, (0.4, 0.55), muted(rng), 1, int(rng.integers(2, 5)))
        parts += faced_box((0.4, d - 0.1, 0.58), (0.5 * w - 0.3, 0, 0), timber, face, rng)
    parts = list(as_part(kinds.DESK, parts))
    x = -0.12 * w
    screens = (x - 0.27, x + 0.27) if w > 1.4 and rng.uniform() < 0.4 else (x,)
    for at in screens if rng.uniform() < 0.85 else ():
        parts += moved(items.monitor(rng), placement(at, -0.08, h, rng.normal(0, 0.1)))
    things = clutter(rng, 0.3, d - 0.06, h, 0.9)
    parts += moved(things, placement(0.5 * w - 0.18, 0, 0))
    seat = office_chair if rng.uniform() < 0.6 else chair
    fabric = textures.fabric(rng, (0.6, 0.6), muted(rng))
    sitter = seat(rng, plain(rng, np.full(3, 50.0)), fabric)
    turn = np.pi + rng.normal(0, 0.5)
    parts += moved(sitter, placement(x, 0.5 * d + rng.uniform(0.0, 0.3), 0, turn))
    return piece("desk", parts, Surface.TABLE)


def desk_island(rng: Rng) -> Piece:
    """Two or four desks face to face."""
    parts: list[Patch] = []
    for column in range(int(rng.integers(1, 3))):
        for yaw in (0.0, np.pi):
            one = desk(rng)
            y = -0.5 * one.size[1] if yaw else 0.5 * one.size[1]
            parts += beside(one, 1.85 * column, y, yaw)
    return piece("desk island", parts)


def coffee_table(rng: Rng) -> Piece:
    """A low table."""
    w, d, h = rng.uniform(0.6, 1.2), rng.uniform(0.45, 0.7), rng.uniform(0.35, 0.48)
    return piece("coffee table", table(rng, w, d, h))


def nightstand(rng: Rng) -> Piece:
    """A small chest beside a bed."""
    w, d, h = rng.uniform(0.35, 0.55), rng.uniform(0.32, 0.42), rng.uniform(0.4, 0.6)
    face = prints.front(rng, (w, h), muted(rng), 1, int(rng.integers(1, 4)))
    body = faced_box((w, d, h), (0, 0, 0), timber_of(rng), face, rng)
    chest = as_part(kinds.NIGHTSTAND, labelled(body, Surface.CABINET))
    return piece("nightstand", chest + clutter(rng, w - 0.05, d - 0.05, h, 0.8))
