"""Procedural furniture. A piece stands on z = 0, centred on its footprint, its front towards +y."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fewview.synthetic import items, kinds, prints, textures
from fewview.synthetic.classes import Surface
from fewview.synthetic.items import Patches, placement
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
from fewview.synthetic.textures import Rng, Texture, brown, muted, plain


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


def piece(name: str, patches: Iterable[Patch], surface: Surface = Surface.OTHER) -> Piece:
    """Centre surfaces on their footprint, measure them and name those that have no name."""
    parts = labelled(patches, surface)
    points = np.concatenate([p.corners.reshape(-1, 3) for p in parts])
    low, high = points.min(axis=0), points.max(axis=0)
    width, depth, _ = high - low
    x, y, _ = -0.5 * (low + high)
    return Piece(name, moved(parts, placement(x, y, 0)), (width, depth, float(high[2])))


def beside(of: Piece, x: float, y: float, yaw: float = 0.0) -> Patches:
    """The surfaces of a piece at another place, for groups."""
    return moved(of.patches, placement(x, y, 0, yaw))


def timber_of(rng: Rng, size_m: float = 0.9) -> Texture:
    """Wood, or lacquer."""
    if rng.uniform() < 0.75:
        return textures.wood(rng, (size_m, 0.7), brown(rng))
    return plain(rng, np.full(3, rng.uniform(170, 240)) if rng.uniform() < 0.6 else muted(rng))


def legs_of(rng: Rng, w: float, d: float, h: float, texture: Texture, thick: float) -> Patch:
    """Four legs under the corners of a top."""
    x, y = 0.5 * w - 0.8 * thick, 0.5 * d - 0.8 * thick
    spots = ((-x, -y), (x, -y), (x, y), (-x, y))
    return boxes([((thick, thick, h), (*spot, 0.0)) for spot in spots], texture, rng)


def floor_lamp(rng: Rng) -> Piece:
    """A tall lamp."""
    return piece("lamp", as_part(kinds.LAMP, items.table_lamp(rng, rng.uniform(1.4, 1.7), 0.14)))


def floor_plant(rng: Rng) -> Piece:
    """A large plant."""
    height = rng.uniform(0.7, 1.5)
    return piece("plant", items.plant(rng, height))


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
    return piece("cartons", as_part(kinds.BOXES, out))


def waste_bin(rng: Rng) -> Piece:
    """A waste-paper bin."""
    profile = [(0.12, 0.0), (0.15, 0.32)]
    body = lathed(profile, (0, 0, 0), plain(rng, muted(rng)))
    return piece("bin", as_part(kinds.BIN, [body]))


def partition(rng: Rng) -> Piece:
    """A fabric screen between places to work."""
    w, h = rng.uniform(1.0, 1.8), rng.uniform(1.2, 1.7)
    cloth, foot = textures.fabric(rng, (1.2, 1.2), muted(rng)), plain(rng, np.full(3, 130.0))
    feet = [((0.05, 0.4, 0.04), (x, 0.0, 0.0)) for x in (0.15 - 0.5 * w, 0.5 * w - 0.15)]
    body = box((w, 0.05, h - 0.04), (0, 0, 0.04), cloth, rng)
    return piece("partition", [body, boxes(feet, foot, rng)])


def column(rng: Rng, height: float) -> Piece:
    """A pillar that carries the ceiling, round or square."""
    paint = textures.paint(rng, (1.6, height), np.full(3, rng.uniform(150, 240)))
    wide = rng.uniform(0.22, 0.5)
    if rng.uniform() < 0.4:
        body = lathed([(0.5 * wide, 0.0), (0.5 * wide, height)], (0, 0, 0), paint)
    else:
        body = box((wide, rng.uniform(0.8, 1.2) * wide, height), (0, 0, 0), paint, rng)
    return piece("column", [body], Surface.WALL)
