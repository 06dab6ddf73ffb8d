"""Small things that lie and stand on furniture."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fewview.synthetic import prints, textures
from fewview.synthetic.classes import Surface
from fewview.synthetic.surfaces import (
    Patch,
    ball,
    box,
    box_corners,
    boxes_corners,
    covered,
    labelled,
    lathed,
    moved,
    printed,
)
from fewview.synthetic.textures import Rng, Texture, muted, plain, vivid
from fewview.types import Array

Patches = tuple[Patch, ...]


def placement(x: float, y: float, z: float, yaw: float = 0.0) -> Array:
    """(4, 4) motion that turns about z, then shifts."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, z], [0, 0, 0, 1]])


def book_row(rng: Rng, width: float, depth: float, height: float) -> Patches:
    """Books side by side from the left, spines towards +y, at most ``width`` in all."""
    thick = rng.uniform(0.018, 0.06, max(2, int(width / 0.018)))
    thick = thick[: max(1, np.searchsorted(np.cumsum(thick), width))]
    n = len(thick)
    deep = rng.uniform(0.6, 0.9, n) * depth
    size = np.stack([thick, deep, rng.uniform(0.6, 0.92, n) * height], axis=-1)
    left = np.cumsum(thick) - 0.5 * thick - 0.5 * width
    back = 0.5 * (depth - deep) - rng.uniform(0, 0.03, n)
    bottoms = np.stack([left, back, np.zeros(n)], axis=-1)
    there = rng.uniform(size=n) < 0.93
    faces = boxes_corners(size[there], bottoms[there])
    spines = prints.spines(rng, thick[there], 0.92 * height)
    paper = covered(faces[:, 4], plain(rng, np.full(3, 225.0)), rng)
    edges = np.append(0, np.cumsum(thick[there])) / spines.texel_m
    return *_bound(faces, edges, spines), paper


def _bound(faces: Array, edges: Array, spines: Texture) -> Patches:
    """Backs (+y) that show their part of the picture, and covers that show a line of it."""
    low = np.full(len(faces), spines.size[1]) - 0.5
    high = low - (faces[:, 2, 2, 2] - faces[:, 2, 0, 2]) / spines.texel_m
    left, right = edges[:-1], edges[1:]
    middle = 0.5 * (left + right)
    backs, sides = (
        np.stack([np.stack([x0, x1, x1, x0], 1) - 0.5, np.stack([low, low, high, high], 1)], -1)
        for x0, x1 in ((left, right), (middle, middle))
    )
    covers = faces[:, [1, 3]].reshape(-1, 4, 3)
    return Patch(faces[:, 2], backs, spines), Patch(covers, np.repeat(sides, 2, axis=0), spines)


def book_pile(rng: Rng) -> Patches:
    """Lying books and magazines, covers up."""
    out: list[Patch] = []
    z = 0.0
    for _ in range(rng.integers(1, 5)):
        size = (rng.uniform(0.16, 0.2), rng.uniform(0.2, 0.26), rng.uniform(0.008, 0.04))
        faces = box_corners(size, (0, 0, 0))
        edges = covered(faces[[0, 1, 2, 3]], plain(rng, vivid(rng)), rng)
        cover = printed(faces[4], prints.poster(rng, size[:2]))
        out += moved((edges, cover), placement(0, 0, z, rng.normal(0, 0.15)))
        z += size[2]
    return tuple(out)


def papers(rng: Rng) -> Patches:
    """Two loose sheets."""
    sheet = box_corners((0.19, 0.25, 0.002), (0, 0, 0))[4]
    out: list[Patch] = []
    for layer in range(2):
        at = placement(0.01 * layer, 0.0, 0.002 * layer, rng.normal(0, 0.2))
        out += moved([printed(sheet, prints.page(rng, (0.19, 0.25)))], at)
    return tuple(out)


def mug(rng: Rng) -> Patches:
    """A cup with a printed band."""
    r, h = rng.uniform(0.035, 0.05), rng.uniform(0.08, 0.11)
    wall = prints.poster(rng, (0.3, h)) if rng.uniform() < 0.5 else plain(rng, vivid(rng))
    return (lathed([(0.9 * r, 0), (r, h)], (0, 0, 0), wall, 12),)


def bottle(rng: Rng) -> Patches:
    """A bottle with a label."""
    r, h = rng.uniform(0.03, 0.045), rng.uniform(0.2, 0.3)
    profile = [(r, 0.0), (r, 0.6 * h), (0.35 * r, 0.8 * h), (0.35 * r, h)]
    body = lathed(profile, (0, 0, 0), plain(rng, vivid(rng)), 12)
    label = lathed(
        [(r + 0.001, 0), (r + 0.001, 0.3 * h)],
        (0, 0, 0.15 * h),
        prints.poster(rng, (6 * r, 0.3 * h)),
        12,
    )
    return body, label


def vase(rng: Rng) -> Patches:
    """A vase or bowl."""
    h, r = rng.uniform(0.08, 0.28), rng.uniform(0.06, 0.1)
    profile = [(0.6 * r, 0), (r, 0.4 * h), (rng.uniform(0.5, 1.0) * r, h)]
    return (lathed(profile, (0, 0, 0), textures.stone(rng, (0.4, 0.4), vivid(rng))),)


def carton(rng: Rng) -> Patches:
    """A box with print on every side."""
    size = rng.uniform(0.08, 0.24, 3).tolist()
    return tuple(
        printed(face, prints.poster(rng, (0.2, 0.2))) for face in box_corners(size, (0, 0, 0))[:5]
    )


def fruit(rng: Rng) -> Patches:
    """Three balls side by side."""
    skin = textures.stone(rng, (0.2, 0.2), vivid(rng))
    spots = ((-0.05, -0.03), (0.05, -0.03), (0.0, 0.06))
    return tuple(ball(0.04, (x, y, 0.04), skin) for x, y in spots)


def frame(rng: Rng) -> Patches:
    """A standing photograph, facing +y."""
    size = (rng.uniform(0.12, 0.22), 0.02, rng.uniform(0.14, 0.26))
    faces = box_corners(size, (0, 0, 0))
    rim = covered(np.delete(faces, 2, axis=0), plain(rng, muted(rng)), rng)
    return rim, printed(faces[2], prints.photo(rng, (size[0], size[2])))


def plant(rng: Rng, height: float = 0.35) -> Patches:
    """Blades that bend out of a pot; ``height`` metres in all."""
    pot_height = 0.35 * height
    pot = lathed(
        [(0.1 * height + 0.02, 0), (0.13 * height + 0.03, pot_height)],
        (0, 0, 0),
        textures.stone(rng, (0.4, 0.4), muted(rng)),
    )
    green = np.array([70.0, 120.0, 55.0]) * rng.uniform(0.6, 1.2) + rng.uniform(-20, 20, 3)
    leaf = textures.stone(rng, (0.3, 0.3), green)
    blades = int(rng.integers(12, 22))
    corners = np.empty((2 * blades, 4, 3))
    for i, yaw in enumerate(rng.uniform(0, 2 * np.pi, blades)):
        out, side = (
            np.array([np.cos(yaw), np.sin(yaw), 0]),
            np.array([-np.sin(yaw), np.cos(yaw), 0]),
        )
        reach, rise = rng.uniform(0.05, 0.35) * height, rng.uniform(0.35, 0.65) * height
        root, wide = np.array([0, 0, pot_height]), rng.uniform(0.03, 0.08) * height * side
        bend = root + 0.5 * reach * out + [0, 0, 0.75 * rise]
        tip = root + reach * out + [0, 0, rise]
        corners[2 * i] = root - 0.3 * wide, root + 0.3 * wide, bend + wide, bend - wide
        corners[2 * i + 1] = bend - wide, bend + wide, tip + 0.2 * wide, tip - 0.2 * wide
    return pot, covered(corners, leaf, rng)


def monitor(rng: Rng) -> Patches:
    """A computer screen on its foot with a keyboard in front, facing +y."""
    width = rng.uniform(0.42, 0.6)
    black = plain(rng, np.full(3, rng.uniform(20, 60)))
    size = (width, 0.03, 0.6 * width)
    case = box_corners(size, (0, -0.08, 0.1))
    picture = printed(case[2], prints.screen(rng, (width, 0.6 * width)))
    keys = prints.front(rng, (0.6, 0.24), np.full(3, rng.uniform(30, 200)), 14, 5)
    parts = (
        covered(np.delete(case, 2, axis=0), black, rng),
        picture,
        box((0.05, 0.03, 0.12), (0, -0.09, 0), black, rng),
        box((0.2, 0.14, 0.01), (0, -0.08, 0), black, rng),
        printed(box_corners((0.4, 0.14, 0.015), (0, 0.16, 0))[4], keys),
    )
    return labelled(parts, Surface.OTHER)


def table_lamp(rng: Rng, height: float = 0.45, spread: float = 0.28) -> Patches:
    """A lamp with a fabric shade."""
    r = spread * height
    shade = textures.fabric(rng, (0.5, 0.3), np.array([225.0, 210, 175]) * rng.uniform(0.6, 1.1))
    foot = plain(rng, muted(rng))
    return (
        lathed(
            [(0.5 * r, 0), (0.5 * r, 0.015), (0.06 * r, 0.03), (0.06 * r, 0.7 * height)],
            (0, 0, 0),
            foot,
        ),
        lathed([(r, 0.62 * height), (0.65 * r, height)], (0, 0, 0), shade),
    )


_ITEMS: tuple[Callable[[Rng], Patches], ...] = (
    book_pile, book_pile, papers, mug, bottle, vase, carton, fruit, frame, plant, table_lamp,
)  # fmt: skip


def clutter(rng: Rng, width: float, depth: float, z: float, share: float = 0.7) -> Patches:
    """Things on a top of ``width`` x ``depth`` at height ``z``, in cells of at least 0.28 m.

    Args:
        rng: chooses the things.
        width: of the top, along x, centred on 0.
        depth: of the top, along y, centred on 0.
        z: height of the top.
        share: part of the cells that is filled.
    """
    columns, rows = max(1, int(width / 0.32)), max(1, int(depth / 0.32))
    out: list[Patch] = []
    for column in range(columns):
        for row in range(rows):
            if rng.uniform() > share:
                continue
            x = width * ((column + 0.5) / columns - 0.5)
            y = depth * ((row + 0.5) / rows - 0.5)
            item = _ITEMS[rng.integers(len(_ITEMS))](rng)
            out += moved(item, placement(x, y, z, rng.normal(0, 0.2)))
    return labelled(out, Surface.OTHER)
