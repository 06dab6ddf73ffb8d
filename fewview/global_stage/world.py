"""The world frame of a component: z up, floor at z = 0 where one is seen, rigid and never scaled.

Up is a vote of the scans' levellings, heading the first Manhattan frame that agrees with it, the
floor a vote of the floors seen. The first scan stands above (or at) the origin.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fewview.geometry import se3
from fewview.types import Array, Levelling

LEAST_CONFIDENCE = 0.2
"""Levellings below this do not vote."""

SAME_UP_RAD = math.radians(10.0)
"""Up directions closer than this support each other."""

SAME_FLOOR_M = 0.15
"""Floor heights closer than this support each other."""

CAMERA_UP = np.array([0.0, -1.0, 0.0])
"""Up in the image: gravity along y, the best guess where no levelling is to be trusted."""


@dataclass(frozen=True)
class WorldFrame:
    """A component's world: (4, 4) world_T_frame, and its kind as in `types.Component`."""

    world_T_frame: Array
    kind: str


def find_world(frame_T_scan: Mapping[int, Array], levellings: Sequence[Levelling]) -> WorldFrame:
    """Level a component.

    Args:
        frame_T_scan: (4, 4) poses of its scans in a common frame, by scan index.
        levellings: one per scan of the whole input.
    """
    scans = sorted(frame_T_scan)
    voters = [i for i in scans if levellings[i].up_confidence >= LEAST_CONFIDENCE]
    up, voters = _up(frame_T_scan, levellings, voters)
    heading = _heading(frame_T_scan, levellings, voters, up)
    x = heading / np.linalg.norm(heading)
    world_R_frame = np.stack([x, np.cross(up, x), up])
    origin = frame_T_scan[scans[0]][:3, 3]
    floor = _floor(frame_T_scan, levellings, voters, up)
    shift = -world_R_frame @ origin
    if floor is None:
        return WorldFrame(se3.pose(world_R_frame, shift), "gravity")
    shift[2] = -floor
    return WorldFrame(se3.pose(world_R_frame, shift), "floor")


def _up(
    frame_T_scan: Mapping[int, Array], levellings: Sequence[Levelling], voters: Sequence[int]
) -> tuple[Array, list[int]]:
    """The up direction of most confidence, and the scans that agree with it."""
    if not voters:
        first = min(frame_T_scan)
        return frame_T_scan[first][:3, :3] @ CAMERA_UP, []
    ups = np.array([frame_T_scan[i][:3, :3] @ levellings[i].level_R_scan[2] for i in voters])
    weight = np.array([levellings[i].up_confidence for i in voters])
    near = ups @ ups.T >= math.cos(SAME_UP_RAD)
    agreeing = near[int(np.argmax(near @ weight))]
    mean = weight[agreeing] @ ups[agreeing]
    return mean / np.linalg.norm(mean), [i for i, ok in zip(voters, agreeing, strict=True) if ok]


def _heading(
    frame_T_scan: Mapping[int, Array],
    levellings: Sequence[Levelling],
    voters: Sequence[int],
    up: Array,
) -> Array:
    """A horizontal direction: along a wall, else where the first camera looks (or its right)."""
    first = frame_T_scan[min(frame_T_scan)][:3, :3]
    walls = [
        frame_T_scan[i][:3, :3] @ levellings[i].level_R_scan[0]
        for i in voters
        if levellings[i].manhattan
    ]
    options = [*walls, first[:, 2], first[:, 0]]
    level = [direction - (direction @ up) * up for direction in options]
    return next(direction for direction in level if np.linalg.norm(direction) > 0.5)


def _floor(
    frame_T_scan: Mapping[int, Array],
    levellings: Sequence[Levelling],
    voters: Sequence[int],
    up: Array,
) -> float | None:
    """Height along ``up`` on which most confidence agrees; the lower of equals."""
    seen = [(i, levellings[i].floor_z) for i in voters]
    heights = np.array([frame_T_scan[i][:3, 3] @ up + z for i, z in seen if z is not None])
    weight = np.array([levellings[i].up_confidence for i, z in seen if z is not None])
    if not len(heights):
        return None
    order = np.argsort(heights, kind="stable")
    heights, weight = heights[order], weight[order]
    near = np.abs(heights[:, None] - heights) <= SAME_FLOOR_M
    agreeing = near[int(np.argmax(near @ weight))]
    total = np.cumsum(weight[agreeing])
    return float(heights[agreeing][np.searchsorted(total, 0.5 * total[-1])])
