"""Ceilings: flat, lower over a part of the room, or sloped under a roof.

The height above a part of a plan is the least of some planes z = a x + b y + c.
"""

from __future__ import annotations

import numpy as np

from fewview.synthetic.shapes import Shape
from fewview.synthetic.textures import Rng
from fewview.types import Array

_KNEE_M = (1.1, 1.7)
_SLOPE = (0.7, 1.4)
_HEADROOM_M = 2.2


def make_ceilings(rng: Rng, shape: Shape) -> tuple[Array, ...]:
    """Planes (m, 3) above each part of a shape."""
    height = rng.uniform(2.3, 3.1)
    flat = np.array([[0.0, 0.0, height]])
    chance = rng.uniform()
    if len(shape.parts) == 1 and chance < 0.2:
        sides = [0] if rng.uniform() < 0.6 else [0, 2]
        slopes = [_slope(rng, shape.parts[0], side) for side in sides]
        roof = np.concatenate([flat, slopes])
        return (roof if heights(roof, shape.parts[0].mean(axis=0)) > _HEADROOM_M else flat,)
    if len(shape.parts) > 1 and chance < 0.35:
        lower = flat - [0.0, 0.0, min(rng.uniform(0.15, 0.5), height - 2.15)]
        return (flat, *[lower] * (len(shape.parts) - 1))
    return (flat,) * len(shape.parts)


def _slope(rng: Rng, part: Array, side: int) -> Array:
    """A roof that rises from one side of a part, from knee height."""
    start, end = part[side], part[(side + 1) % 4]
    along = (end - start) / np.linalg.norm(end - start)
    rise = rng.uniform(*_SLOPE) * np.array([-along[1], along[0]])
    return np.array([*rise, rng.uniform(*_KNEE_M) - rise @ start])


def heights(planes: Array, points: Array) -> Array:
    """(...) heights of a part's ceiling over points (..., 2)."""
    return np.asarray((points @ planes[:, :2].T + planes[:, 2]).min(axis=-1))


def faces(planes: Array, part: Array) -> list[tuple[int, Array]]:
    """What is seen of each plane (its number) from below: quadrilaterals (q, 4, 3), facing down.

    A quadrilateral may have two corners in one place.
    """
    out = []
    for number, plane in enumerate(planes):
        polygon = part
        for other in np.delete(planes, number, axis=0):
            polygon = clipped(polygon, other - plane)
        if len(polygon) > 2:
            z = polygon @ plane[:2] + plane[2]
            out.append((number, _quads(np.column_stack([polygon, z])[::-1])))
    return out


def clipped(polygon: Array, line: Array) -> Array:
    """The part of a convex polygon (n, 2) where a x + b y + c >= 0 (Sutherland and Hodgman)."""
    side = polygon @ line[:2] + line[2]
    out: list[Array] = []
    for i in range(len(polygon)):
        j = (i + 1) % len(polygon)
        if side[i] >= 0:
            out.append(polygon[i])
        if (side[i] >= 0) != (side[j] >= 0):
            share = side[i] / (side[i] - side[j])
            out.append(polygon[i] + share * (polygon[j] - polygon[i]))
    return np.array(out).reshape(-1, 2)


def _quads(polygon: Array) -> Array:
    """A fan of quadrilaterals around the first corner of a convex polygon (n, 3)."""
    quads = []
    for i in range(1, len(polygon) - 1, 2):
        quads.append(polygon[[0, i, i + 1, min(i + 2, len(polygon) - 1)]])
    return np.array(quads)


def breaks(planes: Array, start: Array, end: Array) -> list[float]:
    """Where, as shares of the way from start to end (2,), one plane gives way to another."""
    a, b = (point @ planes[:, :2].T + planes[:, 2] for point in (start, end))
    out = []
    for i in range(len(planes)):
        for j in range(i):
            first, last = a[i] - a[j], b[i] - b[j]
            if first * last < 0:
                out.append(float(first / (first - last)))
    return sorted(out)
