"""Light from lamps under the ceiling, and how film takes it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fewview.synthetic.hits import Hits
from fewview.synthetic.rays import Caster
from fewview.synthetic.room import Room
from fewview.types import Array, FloatArray, IntArray

_FILM = 360.0
_LIFT_M = np.float32(0.006)


def arriving(room: Room, hits: Hits, visibility: Callable[[Array], FloatArray]) -> FloatArray:
    """(n,) light at surface points: ambient, and by Lambert's law from each lamp.

    Args:
        room: whose lamps.
        hits: the points.
        visibility: from a lamp's place (3,) to the share 0..1 of it that each point sees.
    """
    total = np.float32(room.ambient) * (1 + np.float32(0.2) * np.abs(hits.normals[:, 2]))
    strength = np.float32(1.1 / np.sqrt(len(room.lamps)))
    for lamp in room.lamps:
        way = lamp.astype(np.float32) - hits.points
        square = np.einsum("ij,ij->i", way, way)
        cosine = np.einsum("ij,ij->i", way, hits.normals) / np.sqrt(square)
        falloff = strength / (np.float32(0.45) + square / 6)
        total += np.maximum(cosine, 0) * falloff * visibility(lamp)
    return total


def seen_from(caster: Caster, lamp: Array, hits: Hits, which: IntArray) -> FloatArray:
    """(m,) 1 where nothing is between a lamp's place and the points number ``which``, else 0."""
    start = (hits.points + _LIFT_M * hits.normals)[which]
    way = lamp.astype(np.float32) - start
    return (~caster.blocked(np.concatenate([start, way], axis=1))).astype(np.float32)


def exposed(colour: FloatArray) -> FloatArray:
    """Film's response to light: linear when dim, saturating slowly."""
    return np.asarray(_FILM * (1 - np.exp(colour / -np.float32(_FILM))), np.float32)
