"""Hand-held cameras in a room: where they can be, and which of them make a set of scans."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import open3d as o3d

from fewview.errors import FewviewError
from fewview.geometry import se3
from fewview.geometry.camera import project
from fewview.synthetic.frames import trace
from fewview.synthetic.handheld import look
from fewview.synthetic.hits import Hits
from fewview.synthetic.room import Room
from fewview.synthetic.structured_light import RANGE_M
from fewview.synthetic.textures import Rng
from fewview.types import Array, BoolArray, Intrinsics

_CLEARANCE_M = 0.4
_BODY_M = 0.2
_COLUMNS = 32
_MAX_ROUNDS = 100
_LINK = (0.15, 0.40)
_TYPICAL_LINK = 0.33
_SIMILAR_COSINE = float(np.cos(np.radians(50)))


class ViewMode(StrEnum):
    """How the views of a set relate."""

    RANDOM = "random"
    SPREAD = "spread"


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """A view and what it sees on a coarse grid of pixels.

    Attributes:
        pose: (4, 4) world_T_camera.
        points: (n, 3) in the world, those that the sensor can reach.
        areas: (n,) surface that each stands for, in arbitrary units.
    """

    pose: Array
    points: Array
    areas: Array


def kinect(width: int = 640, height: int = 480, focal: float = 555.0) -> Intrinsics:
    """A Kinect-like camera; ``focal`` is in pixels of an image 640 wide."""
    scale = width / 640.0
    return Intrinsics(
        width, height, focal * scale, focal * scale, 0.5 * (width - 1), 0.5 * (height - 1)
    )


def free_places(room: Room, points: Array) -> BoolArray:
    """Which of (n, 3) points a person could hold a camera at.

    The camera is 0.4 m from every surface, nothing stands between it and the floor below, and
    there is a little room around that line.
    """
    heights = np.linspace(0.25, 1.0, 4)[:, None]
    column = points[:, None] * [1, 1, 0] + heights * points[:, None, 2:] * [0, 0, 1]
    gaps = _distance(room, column.reshape(-1, 3)).reshape(len(points), -1)
    down = np.concatenate([points, np.broadcast_to([0.0, 0.0, -1.0], points.shape)], axis=1)
    fall = room.scene.cast_rays(o3d.core.Tensor(down.astype(np.float32)))["t_hit"].numpy()
    stands = fall > points[:, 2] - 0.05
    free = (gaps[:, -1] >= _CLEARANCE_M) & (gaps.min(axis=1) >= _BODY_M)
    return np.asarray(free & stands & room.plan.contains(points[:, :2]))


def _distance(room: Room, points: Array) -> Array:
    query = o3d.core.Tensor(points.astype(np.float32))
    return np.asarray(room.scene.compute_distance(query).numpy(), np.float64)


def sample_viewpoints(room: Room, count: int, rng: Rng, intrinsics: Intrinsics) -> list[Viewpoint]:
    """Independent random views: free places, 1.2-1.7 m high, that look at something.

    Args:
        room: where to stand.
        count: number of views.
        rng: chooses them.
        intrinsics: of the camera.

    Raises:
        FewviewError: the room has too few places to stand.
    """
    low, high = room.plan.outline.min(axis=0), room.plan.outline.max(axis=0)
    out: list[Viewpoint] = []
    for _ in range(_MAX_ROUNDS):
        places = rng.uniform([*low, 1.2], [*high, 1.7], (4 * count, 3))
        for place in places[free_places(room, places)]:
            angles = rng.uniform(
                [-np.pi, -np.radians(30), -np.radians(5)], [np.pi, np.radians(5), np.radians(5)]
            )
            pose = look(place, *angles)
            hits = trace(room, pose, _coarse(intrinsics))
            view = _reached(pose, hits)
            wide = np.median(hits.depth) > 1.5 and len(view.points) > 0.6 * len(hits.depth)
            if wide and len(np.unique(hits.quad)) >= 18:
                out.append(view)
        if len(out) >= count:
            return out[:count]
    raise FewviewError(f"the room has no place for {count} scans; take fewer or another seed")


def _coarse(intrinsics: Intrinsics) -> Intrinsics:
    return intrinsics.resized(_COLUMNS, _COLUMNS * intrinsics.height // intrinsics.width)


def viewpoint(room: Room, pose: Array, intrinsics: Intrinsics) -> Viewpoint:
    """What the view from (4, 4) world_T_camera sees."""
    return _reached(pose, trace(room, pose, _coarse(intrinsics)))


def _reached(pose: Array, hits: Hits) -> Viewpoint:
    near, far = RANGE_M
    reached = (hits.depth > near) & (hits.depth < far)
    areas = hits.depth[reached] ** 2 / np.maximum(hits.cosine[reached], 0.1)
    return Viewpoint(pose, hits.points[reached].astype(np.float64), areas.astype(np.float64))


def overlap(room: Room, a: Viewpoint, b: Viewpoint, intrinsics: Intrinsics) -> float:
    """Share of the surface seen by the view that sees less of it which the other sees too."""
    less, more = (a, b) if a.areas.sum() <= b.areas.sum() else (b, a)
    seen = _seen_from(room, less.points, more.pose, intrinsics)
    return float(less.areas[seen].sum() / less.areas.sum())


def _seen_from(room: Room, points: Array, pose: Array, intrinsics: Intrinsics) -> BoolArray:
    """Which of (n, 3) world points a view sees within the sensor's range."""
    local = se3.transform(se3.inverse(pose), points)
    _, inside = project(local, intrinsics)
    near, far = RANGE_M
    inside &= (local[:, 2] > near) & (local[:, 2] < far)
    eye = pose[:3, 3]
    beams = np.concatenate([np.broadcast_to(eye, points.shape), points - eye], axis=1)
    hidden = room.scene.test_occlusions(
        o3d.core.Tensor(beams.astype(np.float32)), tnear=0.0, tfar=0.985
    )
    return np.asarray(inside & ~hidden.numpy())


def sample_views(
    room: Room,
    count: int,
    seed: int,
    mode: ViewMode | str = ViewMode.SPREAD,
    intrinsics: Intrinsics | None = None,
) -> list[Array]:
    """Camera poses for a set of scans.

    Args:
        room: where to stand.
        count: number of views.
        seed: chooses them; other seeds give other views of the same room.
        mode: ``"random"`` draws each view independently; ``"spread"`` draws views that see
            different things, each overlapping an earlier one by 15 to 40 % and none by more, as
            far as the room allows.
        intrinsics: of the camera; `kinect` when not given.

    Returns:
        (4, 4) world_T_scan each, OpenCV axes.

    Raises:
        FewviewError: the room has too few places to stand.
    """
    camera = intrinsics or kinect()
    rng = np.random.default_rng(seed)
    if ViewMode(mode) is ViewMode.RANDOM:
        return [v.pose for v in sample_viewpoints(room, count, rng, camera)]
    pool = sample_viewpoints(room, 80 + 10 * count, rng, camera)
    return [v.pose for v in _spread(room, pool, count, camera)]


def _spread(
    room: Room, pool: list[Viewpoint], count: int, intrinsics: Intrinsics
) -> list[Viewpoint]:
    """Greedy: next the view whose best link is typical and whose other overlaps are smallest.

    A link is the overlap with a view of similar direction: views that face each other can share
    much surface without a single point looking alike.
    """
    ahead = np.array([v.pose[:3, 2] for v in pool])
    chosen = [0]
    shares = np.zeros((0, len(pool)))
    while len(chosen) < count:
        last = pool[chosen[-1]]
        shares = np.vstack([shares, [overlap(room, last, v, intrinsics) for v in pool]])
        link = np.where(ahead[chosen] @ ahead.T > _SIMILAR_COSINE, shares, 0.0).max(axis=0)
        most = shares.max(axis=0)
        outside = np.maximum(_LINK[0] - link, 0) + np.maximum(most - _LINK[1], 0)
        cost = np.abs(link - _TYPICAL_LINK) + 0.5 * (shares.sum(axis=0) - most) + 10 * outside
        cost[chosen] = np.inf
        chosen.append(int(np.argmin(cost)))
    return [pool[i] for i in chosen]
