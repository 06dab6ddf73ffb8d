"""What the structure network should say: the true planes of points, and walls in their slots."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fewview.completion.panorama.ring import ring_points
from fewview.completion.structure import anchors
from fewview.geometry import se3
from fewview.training.point_batches import CEILING, FLOOR, WALL
from fewview.types import Array, BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from fewview.synthetic.samples import RoomSample

ON_PLANE_M = 0.06
ON_PLANE_COS = 0.9
KIND_OF_SURFACE = np.array([0, WALL, FLOOR, CEILING, WALL, WALL, 0, 0, 0, 0, 0, 0])
STRIDE = 3
MIN_SHOWN = 20
FLAT = 0.99
TRIM = 0.01
FARTHEST_M = anchors.NEAREST_M + anchors.BINS * anchors.BIN_M - 0.5 * anchors.BIN_M


class PlaneTruth(NamedTuple):
    """The planes of V cameras of a room, P at most.

    Attributes:
        planes: (V, P, 4) normal and offset in frames at the cameras; kind: (V, P).
        centre: (V, P, 3) middle of the plane; known: (V, P) bool, whether the rings show it.
        level: (V, 2) number of the floor and of the flat ceiling that the rings show most of, -1
            for none.
    """

    planes: FloatArray
    kind: NDArray[np.uint8]
    centre: FloatArray
    known: BoolArray
    level: IntArray


class Slots(NamedTuple):
    """Walls by sector, K = ANCHORS x SLOTS, of V cameras; zeros where there is none.

    Attributes:
        plane: (V, K) number of the plane, -1 none.
        azimuth, distance, middle: (V, K), see `anchors`.
        middle_known: (V, K) bool.
    """

    plane: IntArray
    azimuth: FloatArray
    distance: FloatArray
    middle: FloatArray
    middle_known: BoolArray


def plane_truth(room: RoomSample) -> PlaneTruth:
    """Centres of a room's planes, the same place for all its cameras.

    A wall's centre is half way between floor and ceiling and in the middle of what all complete
    rings together show of it; floor and ceiling are measured along the first wall.
    """
    poses = room.level_T_world[0] @ se3.inverse(room.level_T_world)
    points = se3.transform(poses, _thinned(ring_points(room.depth)).astype(np.float64))
    normals = se3.rotate(poses, _thinned(room.normal).astype(np.float64))
    surface = _thinned(room.semantics[..., None])
    planes, kind = room.planes[0].astype(np.float64), room.plane_kind[0]
    label = plane_of(points.reshape(-1, 3), normals.reshape(-1, 3), surface.ravel(), planes, kind)
    shown = np.bincount(label[label >= 0], minlength=len(planes))
    level = _main_levels(planes, kind, shown)
    centre = _centres(points.reshape(-1, 3), label, planes, kind, level)
    back = se3.transform(se3.inverse(poses), np.broadcast_to(centre, (len(poses), *centre.shape)))
    return PlaneTruth(
        room.planes,
        room.plane_kind,
        back.astype(np.float32),
        np.broadcast_to(shown >= MIN_SHOWN, room.plane_kind.shape),
        np.broadcast_to(level, (len(poses), 2)),
    )


def turned(truth: PlaneTruth, turns: FloatArray) -> PlaneTruth:
    """The same planes in frames turned by (V, 3, 3)."""
    back = turns.swapaxes(1, 2)
    planes = np.concatenate([truth.planes[..., :3] @ back, truth.planes[..., 3:]], axis=-1)
    return truth._replace(planes=planes, centre=truth.centre @ back)


def plane_of(
    points: Array,
    normals: Array,
    surface: NDArray[np.uint8],
    planes: Array,
    kind: NDArray[np.uint8],
) -> IntArray:
    """The structural plane (n,) that each point lies on, -1 for none.

    Args:
        points: (n, 3); normals: (n, 3); surface: (n,) semantic class.
        planes: (P, 4); kind: (P,), in the same frame.
    """
    away = np.abs(points @ planes[:, :3].T - planes[:, 3])
    fits = (away < ON_PLANE_M) & (normals @ planes[:, :3].T > ON_PLANE_COS)
    fits &= (KIND_OF_SURFACE[surface][:, None] == kind) & (kind > 0)
    nearest = np.where(fits, away, np.inf).argmin(axis=1)
    return np.where(fits.any(axis=1), nearest, -1)


def wall_slots(truth: PlaneTruth) -> Slots:
    """Put the walls into the sectors that they lie in, the nearest `SLOTS` of each.

    Walls on the same plane count once, walls out of the range of the distances not at all.
    """
    views, count = len(truth.planes), anchors.ANCHORS * anchors.SLOTS
    plane = np.full((views, count), -1, np.int64)
    values = np.zeros((3, views, count), np.float32)
    known = np.zeros((views, count), bool)
    for v in range(views):
        azimuth, distance, middle = _polar(truth, v)
        use = (truth.kind[v] == WALL) & (distance > anchors.NEAREST_M) & (distance < FARTHEST_M)
        sector = np.rint(azimuth / anchors.SECTOR).astype(int) % anchors.ANCHORS
        for k in range(anchors.ANCHORS):
            mine = _single(np.flatnonzero(use & (sector == k)), distance)
            for slot, p in enumerate(mine, k * anchors.SLOTS):
                plane[v, slot], known[v, slot] = p, truth.known[v, p]
                values[:, v, slot] = azimuth[p], distance[p], middle[p]
    return Slots(plane, values[0], values[1], values[2], known)


def _thinned(images: NDArray[Any]) -> NDArray[Any]:
    """(V, S, 4 S, C) to (V, n, C)."""
    return images[:, ::STRIDE, ::STRIDE].reshape(len(images), -1, images.shape[-1])


def _single(walls: IntArray, distance: FloatArray) -> list[int]:
    """Of the walls of one sector the nearest to the camera, nearer first, one per plane."""
    chosen: list[int] = []
    for p in walls[np.argsort(np.abs(distance[walls]), kind="stable")]:
        if all(abs(distance[p] - distance[q]) > anchors.SAME_M for q in chosen):
            chosen.append(int(p))
    return sorted(chosen[: anchors.SLOTS], key=lambda p: float(distance[p]))


def _polar(truth: PlaneTruth, view: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Outward azimuth, distance and middle (P,) of all planes as if they were walls."""
    plane, centre = truth.planes[view], truth.centre[view]
    azimuth = np.arctan2(-plane[:, 1], -plane[:, 0])
    middle = centre[:, 1] * np.cos(azimuth) - centre[:, 0] * np.sin(azimuth)
    return azimuth, -plane[:, 3], middle


def _main_levels(planes: Array, kind: NDArray[np.uint8], shown: IntArray) -> IntArray:
    flat = np.abs(planes[:, 2]) > FLAT
    out = []
    for wanted in (FLOOR, CEILING):
        mine = flat & (kind == wanted)
        out.append(int(np.where(mine, shown, -1).argmax()) if mine.any() else -1)
    return np.array(out, np.int64)


def _centres(
    points: Array, label: IntArray, planes: Array, kind: NDArray[np.uint8], level: IntArray
) -> Array:
    centre = np.zeros((len(planes), 3))
    half_way = np.mean([planes[p, 2] * planes[p, 3] for p in level if p >= 0] or [0.0])
    walls = np.flatnonzero(kind == WALL)
    first = planes[walls[0], :3] if len(walls) else np.array([1.0, 0.0, 0.0])
    for p in np.flatnonzero(kind):
        mine, normal = points[label == p], planes[p, :3]
        across = normal if kind[p] == WALL else first
        along = np.array([-across[1], across[0], 0.0])
        centre[p] = _middle(mine @ along) * along
        if kind[p] == WALL:
            centre[p, 2] = half_way
        else:
            centre[p] += _middle(mine @ across) * across
        centre[p] += (planes[p, 3] - normal @ centre[p]) * normal
    return centre


def _middle(values: Array) -> float:
    return float(np.quantile(values, [TRIM, 1.0 - TRIM]).mean()) if len(values) else 0.0
