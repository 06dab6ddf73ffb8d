"""Cameras as people hold them, for training: varied heights, tilts and fields of view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fewview.errors import FewviewError
from fewview.geometry import se3
from fewview.synthetic.classes import Ground
from fewview.synthetic.floor_map import CELL_M, FloorMap
from fewview.synthetic.items import placement
from fewview.synthetic.plan import Plan
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


def look(position: Array, yaw: float, pitch: float, roll: float) -> Array:
    """(4, 4) world_T_camera; pitch is positive upwards, roll is about the optical axis, radians."""
    ahead = np.array([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    level = np.stack([right, np.cross(ahead, right), ahead], axis=-1)
    return se3.pose(level @ se3.rotation_exp(np.array([0.0, 0.0, roll])), position)


def cameras(plan: Plan, above: FloorMap, count: int, rng: Rng) -> list[Camera]:
    """Independent views from free places, most of them with some space ahead.

    Rooms next door are taken as often as their floor is large.

    Raises:
        FewviewError: there is no place to stand.
    """
    for clearance in _CLEARANCES_M:
        places = [above.places(clearance, number) for number in range(len(plan.rooms))]
        if sum(map(len, places)):
            weights = np.array([len(p) for p in places], np.float64)
            rooms = rng.choice(len(places), count, p=weights / weights.sum())
            return [_camera(places[i], plan.rooms[i], above, rng) for i in rooms]
    raise FewviewError("the room has no place to stand; take another seed")


def _camera(places: Array, plan: Plan, above: FloorMap, rng: Rng) -> Camera:
    place, yaw = _heading(places, above, rng)
    highest = min(1.8, float(plan.height_at(place[None])[0]) - 0.25)
    eye = np.append(place, rng.uniform(min(1.0, highest - 0.1), highest))
    pitch, roll = rng.uniform(np.radians(-35), np.radians(15)), np.radians(rng.uniform(-6, 6))
    held = look(np.zeros(3), 0.0, pitch, roll)[:3, :3]
    kind = rng.integers(len(_LENSES_DEG))
    width, high = 0.5 * np.radians(_LENSES_DEG[kind])
    world_T_level = placement(float(eye[0]), float(eye[1]), float(eye[2]), yaw)
    return Camera(se3.inverse(world_T_level), held.T, (width, high), _RANGES_M[kind])


def _heading(places: Array, above: FloorMap, rng: Rng) -> tuple[Array, float]:
    """A place and a direction; directions straight into a wall are tried again, a few times."""
    for _ in range(4):
        place = places[rng.integers(len(places))] + rng.uniform(-0.5, 0.5, 2) * CELL_M
        yaw = float(rng.uniform(-np.pi, np.pi))
        ahead = np.linspace(0, _AHEAD_M, 13)[:, None] * [np.cos(yaw), np.sin(yaw)]
        if (above.at(place + ahead)[0] != Ground.WALL).all():
            break
    return place, yaw
