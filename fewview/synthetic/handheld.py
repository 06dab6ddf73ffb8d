"""Cameras as people hold them, for training: varied heights, tilts and fields of view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fewview.errors import FewviewError
from fewview.geometry import se3
from fewview.synthetic.camera import look
from fewview.synthetic.classes import Ground
from fewview.synthetic.floor_map import FloorMap
from fewview.synthetic.room import Room
from fewview.synthetic.textures import Rng
from fewview.types import Array

_CLEARANCES_M = (0.35, 0.2, 0.1)
_LENSES_DEG = ((60.0, 75.0), (57.0, 43.0), (70.0, 55.0), (90.0, 74.0))
_RANGES_M = ((0.25, 5.0), (0.4, 4.5), (0.4, 5.0), (0.5, 4.0))
_AHEAD_M = 1.2


@dataclass(frozen=True, eq=False)
class Camera:
    """A held camera.

    Attributes:
        level_T_world: (4, 4) into its level frame.
        scan_R_level: (3, 3) its axes as held, pitch and roll.
        half_angles: half the horizontal and vertical field of view, radians.
        range_m: nearest and farthest depth it measures.
    """

    level_T_world: Array
    scan_R_level: Array
    half_angles: tuple[float, float]
    range_m: tuple[float, float]


def cameras(room: Room, above: FloorMap, count: int, rng: Rng) -> list[Camera]:
    """Independent views from free places, most of them with some room ahead.

    Raises:
        FewviewError: there is no place to stand.
    """
    for clearance in _CLEARANCES_M:
        places = above.places(clearance)
        if len(places):
            return [_camera(places, above, room.plan.height, rng) for _ in range(count)]
    raise FewviewError("the room has no place to stand; take another seed")


def _camera(places: Array, above: FloorMap, height: float, rng: Rng) -> Camera:
    place, yaw = _heading(places, above, rng)
    eye = np.append(place, rng.uniform(1.0, min(1.8, height - 0.4)))
    pitch, roll = rng.uniform(np.radians(-35), np.radians(15)), np.radians(rng.uniform(-6, 6))
    held = look(np.zeros(3), 0.0, pitch, roll)[:3, :3]
    kind = rng.integers(len(_LENSES_DEG))
    width, high = 0.5 * np.radians(_LENSES_DEG[kind])
    level = look(eye, yaw, 0.0, 0.0)[:3, :3] @ look(np.zeros(3), 0.0, 0.0, 0.0)[:3, :3].T
    return Camera(se3.inverse(se3.pose(level, eye)), held.T, (width, high), _RANGES_M[kind])


def _heading(places: Array, above: FloorMap, rng: Rng) -> tuple[Array, float]:
    """A place and a direction; directions straight into a wall are tried again, a few times."""
    for _ in range(4):
        place = places[rng.integers(len(places))]
        yaw = float(rng.uniform(-np.pi, np.pi))
        ahead = np.linspace(0, _AHEAD_M, 13)[:, None] * [np.cos(yaw), np.sin(yaw)]
        if (above.at(place + ahead) != Ground.WALL).all():
            break
    return place, yaw
