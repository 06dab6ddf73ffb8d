"""Outlines of rooms: boxes, L, T, niches, chimney breasts and cut corners, with slanted walls."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fewview.synthetic.textures import Rng
from fewview.types import Array

_Points = list[tuple[float, float]]
_Quads = list[_Points]


@dataclass(frozen=True, eq=False)
class Shape:
    """A polygon and how it falls apart.

    Attributes:
        outline: (n, 2) corners, counter-clockwise, metres.
        parts: (k, 4, 2) convex quadrilaterals that tile it, the main one first.
    """

    outline: Array
    parts: Array


def make_shape(rng: Rng) -> Shape:
    """A room's shape, centred, turned by any angle, often with walls that are not at right angles.

    Every sixth is as large as a hall.
    """
    longest = 10.0 if rng.uniform() < 0.17 else 7.0
    w = rng.uniform(2.8, longest)
    d = rng.uniform(max(2.4, 0.5 * w), min(0.8 * longest, 1.3 * w))
    kind = rng.choice(len(_KINDS), p=_CHANCES)
    points, quads = _KINDS[kind](rng, w, d)
    outline, parts = np.array(points), np.array(quads)
    if rng.uniform() < 0.5:
        slant = rng.uniform(-0.13, 0.13, 2)
        outline, parts = (_slanted(p, slant, (w, d)) for p in (outline, parts))
    yaw = rng.uniform(-np.pi, np.pi)
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    middle = outline.mean(axis=0)
    return Shape((outline - middle) @ turn.T, (parts - middle) @ turn.T)


def _slanted(points: Array, slant: Array, size: tuple[float, float]) -> Array:
    """A bilinear map: lines along x and y stay straight but cease to be parallel."""
    x, y = points[..., 0], points[..., 1]
    return np.stack([x * (1 + slant[0] * y / size[1]), y * (1 + slant[1] * x / size[0])], axis=-1)


def rectangle(x0: float, y0: float, x1: float, y1: float) -> _Points:
    """Its corners, counter-clockwise."""
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


def _box(rng: Rng, w: float, d: float) -> tuple[_Points, _Quads]:
    return rectangle(0, 0, w, d), [rectangle(0, 0, w, d)]


def _l(rng: Rng, w: float, d: float) -> tuple[_Points, _Quads]:
    w, d = w + 0.8, d + 0.8
    x, y = w * rng.uniform(0.4, 0.65), d * rng.uniform(0.45, 0.65)
    outline = [(0.0, 0.0), (w, 0), (w, y), (x, y), (x, d), (0, d)]
    return outline, [rectangle(0, 0, w, y), rectangle(0, y, x, d)]


def _t(rng: Rng, w: float, d: float) -> tuple[_Points, _Quads]:
    w, d = w + 0.6, d + 0.8
    x0, x1 = w * rng.uniform(0.15, 0.3), w * rng.uniform(0.65, 0.85)
    y = d * rng.uniform(0.5, 0.65)
    outline = [(0.0, 0.0), (w, 0), (w, y), (x1, y), (x1, d), (x0, d), (x0, y), (0, y)]
    return outline, [rectangle(0, 0, w, y), rectangle(x0, y, x1, d)]


def _niche(rng: Rng, w: float, d: float) -> tuple[_Points, _Quads]:
    wide, deep = rng.uniform(0.7, min(2.2, 0.6 * w)), rng.uniform(0.25, 0.9)
    x0 = rng.uniform(0.3, w - wide - 0.3)
    x1 = x0 + wide
    outline = [(0.0, 0.0), (w, 0), (w, d), (x1, d), (x1, d + deep), (x0, d + deep), (x0, d), (0, d)]
    return outline, [rectangle(0, 0, w, d), rectangle(x0, d, x1, d + deep)]


def _chimney(rng: Rng, w: float, d: float) -> tuple[_Points, _Quads]:
    wide, deep = rng.uniform(0.4, 1.4), rng.uniform(0.25, 0.5)
    x0 = rng.uniform(0.5, w - wide - 0.5)
    x1, y = x0 + wide, d - deep
    outline = [(0.0, 0.0), (w, 0), (w, d), (x1, d), (x1, y), (x0, y), (x0, d), (0, d)]
    parts = [rectangle(0, 0, w, y), rectangle(0, y, x0, d), rectangle(x1, y, w, d)]
    return outline, parts


def _cut_corner(rng: Rng, w: float, d: float) -> tuple[_Points, _Quads]:
    x, y = w - rng.uniform(0.6, 1.3), d - rng.uniform(0.6, 1.3)
    outline = [(0.0, 0.0), (w, 0), (w, y), (x, d), (0, d)]
    return outline, [rectangle(0, 0, w, y), [(0.0, y), (w, y), (x, d), (0.0, d)]]


_KINDS: tuple[Callable[[Rng, float, float], tuple[_Points, _Quads]], ...] = (
    _box, _l, _t, _niche, _chimney, _cut_corner,
)  # fmt: skip
_CHANCES = (0.42, 0.2, 0.1, 0.12, 0.1, 0.06)
