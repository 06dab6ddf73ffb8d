"""What one sits and lies on."""

from __future__ import annotations

import numpy as np

from fewview.synthetic import kinds, textures
from fewview.synthetic.classes import Surface
from fewview.synthetic.furniture import Piece, beside, legs_of, piece, timber_of
from fewview.synthetic.items import Patches, placement
from fewview.synthetic.surfaces import Patch, as_part, box, labelled, moved
from fewview.synthetic.tables import coffee_table, nightstand
from fewview.synthetic.textures import Rng, Texture, muted, vivid


def sofa(rng: Rng) -> Piece:
    """A couch."""
    cloth = textures.fabric(rng, (1.2, 0.8), muted(rng))
    return piece("sofa", as_part(kinds.SOFA, _couch(rng, rng.uniform(1.4, 2.3), cloth)))


def corner_sofa(rng: Rng) -> Piece:
    """A couch with a longer seat at its left end."""
    w, cloth = rng.uniform(2.1, 2.8), textures.fabric(rng, (1.2, 0.8), muted(rng))
    long = rng.uniform(0.5, 0.8)
    seat = box((0.85, long, 0.42), (0.43 - 0.5 * w, 0.44 + 0.5 * long, 0.04), cloth, rng)
    parts = [*_couch(rng, w, cloth), *labelled([seat], Surface.SOFA)]
    return piece("corner sofa", as_part(kinds.SOFA, parts))


def _couch(rng: Rng, w: float, cloth: Texture) -> Patches:
    """Seat cushions between arms before a back, with throw pillows."""
    d, back = rng.uniform(0.8, 0.95), rng.uniform(0.7, 0.9)
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
    return labelled(parts, Surface.SOFA)


def armchair(rng: Rng) -> Piece:
    """A single upholstered seat."""
    cloth = textures.fabric(rng, (0.9, 0.8), vivid(rng) * 0.6 + 40)
    parts = (
        box((0.8, 0.75, 0.42), (0, 0, 0.03), cloth, rng),
        box((0.8, 0.18, 0.45), (0, -0.285, 0.45), cloth, rng),
        *(box((0.14, 0.57, 0.18), (x, 0.09, 0.45), cloth, rng) for x in (-0.33, 0.33)),
    )
    return piece("armchair", as_part(kinds.ARMCHAIR, parts), Surface.SOFA)


def lounge(rng: Rng) -> Piece:
    """A couch with a low table before it and armchairs at its sides, facing inwards."""
    couch = corner_sofa(rng) if rng.uniform() < 0.3 else sofa(rng)
    low = coffee_table(rng)
    front = 0.5 * couch.size[1] + rng.uniform(0.3, 0.5) + 0.5 * low.size[1]
    parts = [*couch.patches, *beside(low, rng.normal(0, 0.15), front, rng.normal(0, 0.05))]
    for side in (-1, 1):
        if rng.uniform() < 0.4:
            away = 0.5 * low.size[0] + rng.uniform(0.5, 0.8)
            parts += beside(
                armchair(rng), side * away, front, side * 0.5 * np.pi + rng.normal(0, 0.2)
            )
    return piece("lounge", parts)


def bench(rng: Rng) -> Piece:
    """A plain bench or stool."""
    w, d, h = rng.uniform(0.35, 1.4), rng.uniform(0.3, 0.4), rng.uniform(0.42, 0.48)
    timber = timber_of(rng)
    top = box((w, d, 0.04), (0, 0, h - 0.04), timber, rng)
    parts = [top, legs_of(rng, w, d, h - 0.04, timber, 0.045)]
    return piece("bench", as_part(kinds.BENCH, parts), Surface.CHAIR)


def bed(rng: Rng) -> Piece:
    """A bed with its headboard against the wall, and blanket and pillows."""
    w, d = rng.uniform(0.95, 1.8), rng.uniform(2.0, 2.15)
    timber, head = timber_of(rng, 1.2), rng.uniform(0.75, 1.15)
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
    return piece("bed", as_part(kinds.BED, parts), Surface.BED)


def sleeping(rng: Rng) -> Piece:
    """A bed between nightstands."""
    couch = bed(rng)
    parts = list(couch.patches)
    for side in (-1, 1):
        if rng.uniform() < 0.6:
            stand = nightstand(rng)
            x = side * (0.5 * (couch.size[0] + stand.size[0]) + 0.04)
            parts += beside(stand, x, 0.5 * (stand.size[1] - couch.size[1]))
    return piece("sleeping", parts)
