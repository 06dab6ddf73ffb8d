"""What is known about the surface points that rays meet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fewview.synthetic.rays import Caster
from fewview.synthetic.room import Room
from fewview.types import FloatArray, IntArray


@dataclass(frozen=True)
class Hits:
    """What the rays of a view meet first, in row-major pixel order.

    Attributes:
        depth: (n,) float32 in lengths of the rays' directions, infinite where nothing is met.
        quad: (n,) index of the quadrilateral, 0 where nothing is met.
        uv: (n, 2) float32 texture pixels.
        points: (n, 3) float32 in the world.
        normals: (n, 3) float32 unit, towards the camera.
        cosine: (n,) float32 of the angle between ray and normal.
    """

    depth: FloatArray
    quad: IntArray
    uv: FloatArray
    points: FloatArray
    normals: FloatArray
    cosine: FloatArray


def hits(room: Room, caster: Caster, beams: FloatArray) -> Hits:
    """Follow rays (n, 6), origins and directions in the world."""
    met = caster.cast(beams)
    directions = beams[:, 3:]
    normals = room.normals[met.triangle]
    facing = np.einsum("ij,ij->i", normals, directions)
    normals *= -np.where(facing < 0, np.float32(-1), np.float32(1))[:, None]
    reach = np.where(np.isfinite(met.depth), met.depth, 0).astype(np.float32)
    return Hits(
        depth=met.depth,
        quad=met.triangle // 2,
        uv=_uv_at(room, met.triangle, met.weights),
        points=beams[:, :3] + reach[:, None] * directions,
        normals=normals,
        cosine=np.abs(facing) / np.sqrt(np.einsum("ij,ij->i", directions, directions)),
    )


def _uv_at(room: Room, triangle: IntArray, weights: FloatArray) -> FloatArray:
    """Interpolate the corners' uv."""
    first = room.uv[:, 0]
    to_second = (room.uv[:, 1:3] - first[:, None]).reshape(-1, 2)
    to_third = (room.uv[:, 2:4] - first[:, None]).reshape(-1, 2)
    out = weights[:, :1] * to_second[triangle]
    out += weights[:, 1:] * to_third[triangle]
    out += first[triangle // 2]
    return out
