"""Chairs, of 0.5 m, their backs at -y."""

from __future__ import annotations

import numpy as np

from fewview.synthetic import kinds
from fewview.synthetic.classes import Surface
from fewview.synthetic.items import Patches
from fewview.synthetic.surfaces import as_part, box, boxes, labelled, lathed
from fewview.synthetic.textures import Rng, Texture, plain


def chair(rng: Rng, timber: Texture, seat: Texture) -> Patches:
    """Four legs and a back, slatted or closed."""
    high, solid = rng.uniform(0.8, 1.0), rng.uniform() < 0.35
    bars = [((0.035, 0.035, high), (x, -0.21, 0.0)) for x in (-0.2, 0.2)]
    bars += [((0.035, 0.035, 0.42), (x, 0.2, 0.0)) for x in (-0.2, 0.2)]
    if not solid:
        step = rng.uniform(0.08, 0.16)
        bars += [((0.4, 0.02, 0.05), (0.0, -0.21, z)) for z in np.arange(0.55, high - 0.06, step)]
    parts = [box((0.45, 0.45, 0.04), (0, 0, 0.42), seat, rng), boxes(bars, timber, rng)]
    if solid:
        parts.append(box((0.42, 0.03, high - 0.58), (0, -0.21, 0.58), seat, rng))
    return as_part(kinds.CHAIR, labelled(parts, Surface.CHAIR))


def office_chair(rng: Rng, timber: Texture, seat: Texture) -> Patches:
    """A swivel chair on a star of castors."""
    black = plain(rng, np.full(3, rng.uniform(25, 80)))
    low, high = rng.uniform(0.42, 0.52), rng.uniform(0.85, 1.15)
    bars = [
        ((0.46, 0.46, 0.08), (0.0, 0.0, low)),
        ((0.42, 0.06, high - low - 0.2), (0.0, -0.23, low + 0.2)),
    ]
    if rng.uniform() < 0.6:
        bars += [((0.05, 0.28, 0.03), (x, 0.0, low + 0.25)) for x in (-0.25, 0.25)]
    foot = [(0.28, 0.02), (0.26, 0.08), (0.04, 0.1), (0.03, low)]
    stem = boxes([((0.06, 0.02, 0.25), (0.0, -0.2, low))], black, rng)
    parts = (boxes(bars, seat, rng), stem, lathed(foot, (0, 0, 0), black, 10))
    return as_part(kinds.CHAIR, labelled(parts, Surface.CHAIR))
