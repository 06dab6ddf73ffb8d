"""Rooms as completion networks learn from them: complete rings, layouts and planes, and what a
scan would have measured of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fewview.geometry import se3
from fewview.synthetic import handheld, ring
from fewview.synthetic.classes import Ground, Surface
from fewview.synthetic.floor_map import FloorMap, floor_map
from fewview.synthetic.handheld import Camera
from fewview.synthetic.hits import Hits, hits
from fewview.synthetic.library import Library
from fewview.synthetic.lighting import arriving, exposed, seen_from
from fewview.synthetic.plan import Plan
from fewview.synthetic.rays import Caster, Embree
from fewview.synthetic.ring_sensor import measure_ring, photograph_ring
from fewview.synthetic.room import Room, make_room
from fewview.synthetic.textures import Rng
from fewview.types import Array, BoolArray, FloatArray, IntArray

GRID = 64
"""Cells along each side of a layout."""
GRID_CELL_M = 0.125
MOST_PLANES = 24
NO_PLANE = 255
_SEEN_SHARE = 0.01
_DARK = 45.0

Bytes = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class RoomSample:
    """V cameras in one room; S is the size of a ring's face, P the most planes, G = `GRID`.

    Level frame: origin at the camera, z up, x along its heading.

    Attributes:
        level_T_world: (V, 4, 4).
        scan_R_level: (V, 3, 3) axes of the cameras as held.
        colour: (V, S, 4 S, 3) uint8.
        depth: (V, S, 4 S) float32 metres along the face's axis, 0 unknown.
        normal: (V, S, 4 S, 3) float32 in the level frame, towards the camera, 0 unknown.
        semantics: (V, S, 4 S) uint8 `Surface`.
        observed: (V, S, 4 S) inside the camera's field of view and range.
        measured: (V, S, 4 S) float32 depth as a sensor gives it where observed, else 0.
        layout: (V, G, G) uint8 `Ground`; row 0 is 4 m ahead, column 0 is 4 m to the left.
        planes: (V, P, 4) float32 normal into the room and offset, n . x = d, in the level frame.
        plane_kind: (V, P) uint8 `PlaneKind`, NONE beyond the last plane.
        plane_id: (V, S, 4 S) uint8 index of the plane that a pixel shows, `NO_PLANE` for none.
    """

    level_T_world: Array
    scan_R_level: Array
    colour: Bytes
    depth: FloatArray
    normal: FloatArray
    semantics: Bytes
    observed: BoolArray
    measured: FloatArray
    layout: Bytes
    planes: FloatArray
    plane_kind: Bytes
    plane_id: Bytes


def room_sample(
    seed: int,
    views: int = 4,
    size: int = 64,
    caster: Callable[[Array], Caster] = Embree,
    library: Library | None = None,
) -> RoomSample:
    """The room of a seed from several places.

    Args:
        seed: of the room; see `fewview.synthetic.split_seed`.
        views: number of cameras.
        size: of a ring's face, pixels.
        caster: what follows rays among quadrilaterals (n, 4, 3).
        library: furniture models, see `make_room`.

    Raises:
        FewviewError: the room has no place to stand.
    """
    room = make_room(seed, library)
    rays = caster(room.corners)
    rng = np.random.default_rng([seed, 1])
    above = floor_map(room, rays)
    cameras = handheld.cameras(room.plan, above, views, rng)
    shape = (views, size, 4 * size)
    level_T_world = np.stack([camera.level_T_world for camera in cameras])
    own = _rooms(room.plan, level_T_world)
    met = hits(room, rays, ring.beams(level_T_world, size))
    quads = met.quad.reshape(shape)
    depth = np.where(np.isfinite(met.depth), met.depth, 0).astype(np.float32).reshape(shape)
    turned = level_T_world[:, :3, :3].swapaxes(1, 2).astype(np.float32)
    normal = met.normals.reshape(views, -1, 3) @ turned
    semantics = np.where(depth > 0, room.surface[quads], np.uint8(Surface.UNKNOWN))
    colour = _lit(room, rays, met, shape)
    cosine = met.cosine.reshape(shape)
    observed, measured = _measured(cameras, depth, cosine, semantics, colour, rng)
    planes, kinds, shown = _planes(room, level_T_world, own, quads)
    return RoomSample(
        level_T_world=level_T_world,
        scan_R_level=np.stack([camera.scan_R_level for camera in cameras]),
        colour=photograph_ring(colour, rng),
        depth=depth,
        normal=np.where(depth[..., None] > 0, normal.reshape(*shape, 3), 0).astype(np.float32),
        semantics=semantics,
        observed=observed,
        measured=measured,
        layout=np.stack([_layout(above, *v) for v in zip(level_T_world, own, depth, strict=True)]),
        planes=planes,
        plane_kind=kinds,
        plane_id=np.where(depth > 0, shown, np.uint8(NO_PLANE)),
    )


def _lit(room: Room, caster: Caster, met: Hits, shape: tuple[int, int, int]) -> FloatArray:
    """(V, S, 4 S, 3) colours; shadows are found at every second pixel."""
    texel = room.texel_m[met.quad]
    footprint = met.depth / (0.5 * shape[1] * texel * np.sqrt(np.maximum(met.cosine, 0.05)))
    which = room.texture[met.quad]
    albedo = room.coarse_atlas.lookup(which, met.uv, footprint.astype(np.float32))
    half = np.arange(len(which)).reshape(shape)[:, ::2, ::2]

    def visibility(lamp: Array) -> FloatArray:
        seen = seen_from(caster, lamp, met, half.ravel()).reshape(half.shape)
        return np.asarray(seen.repeat(2, axis=1).repeat(2, axis=2).ravel())

    light = arriving(room, met, visibility)
    return exposed(albedo * light[:, None]).reshape(*shape, 3)


def _rooms(plan: Plan, level_T_world: Array) -> IntArray:
    """(V,) the room in which each camera is."""
    places = se3.inverse(level_T_world)[:, :2, 3]
    return np.asarray(np.argmax([room.contains(places) for room in plan.rooms], axis=0), np.int64)


def _measured(
    cameras: list[Camera],
    depth: FloatArray,
    cosine: FloatArray,
    semantics: Bytes,
    colour: FloatArray,
    rng: Rng,
) -> tuple[BoolArray, FloatArray]:
    """Where each camera looks and reaches, and the depth that it measures there."""
    observed, measured = np.zeros(depth.shape, bool), np.zeros_like(depth)
    glass, dark = semantics == Surface.WINDOW, colour.max(axis=-1) < _DARK
    for i, camera in enumerate(cameras):
        inside, slope = ring.seen_by(camera.scan_R_level, camera.half_angles, depth.shape[1])
        along = depth[i] * slope
        observed[i] = inside & (along > camera.range_m[0]) & (along < camera.range_m[1])
        sensed = measure_ring(along, observed[i], cosine[i], glass[i], dark[i], rng)
        measured[i] = np.where(sensed > 0, sensed / np.where(inside, slope, 1), 0)
    return observed, measured


def _layout(above: FloorMap, level_T_world: Array, own: int, depth: FloatArray) -> Bytes:
    """The map around a camera: all of its own room, and of others what is in sight."""
    offset = GRID_CELL_M * (0.5 * (GRID - 1) - np.arange(GRID))
    x, y = np.meshgrid(offset, offset, indexing="ij")
    level = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    world = se3.transform(se3.inverse(level_T_world), level)[:, :2]
    cells, rooms = above.at(world)
    shown = (rooms >> own & 1 > 0) | (np.hypot(*level[:, :2].T) < ring.sight(depth, level) + 0.1)
    return np.where(shown, cells, np.uint8(Ground.UNKNOWN)).reshape(GRID, GRID)


def _planes(
    room: Room, level_T_world: Array, own: IntArray, quads: IntArray
) -> tuple[FloatArray, Bytes, Bytes]:
    """Each camera's own room's planes, then those of others that it sees much of.

    Returns:
        `RoomSample.planes`, their kinds, and which of them each quadrilateral of ``quads`` is on.
    """
    structure = room.structure
    world = np.array(structure.planes)
    out = np.zeros((len(own), MOST_PLANES, 4), np.float32)
    kind = np.zeros(out.shape[:2], np.uint8)
    shown = np.empty(quads.shape, np.uint8)
    for view, pose in enumerate(level_T_world):
        seen = np.bincount(room.plane[quads[view]].ravel() + 1, minlength=len(world) + 1)[1:]
        others = set(np.flatnonzero(seen > _SEEN_SHARE * quads[view].size).tolist())
        mine = structure.of_room[own[view]]
        numbers = [*sorted(mine), *sorted(others - mine)][:MOST_PLANES]
        normals = world[numbers, :3] @ pose[:3, :3].T
        offsets = world[numbers, 3] + normals @ pose[:3, 3]
        out[view, : len(numbers)] = np.column_stack([normals, offsets])
        kind[view, : len(numbers)] = [structure.kinds[n] for n in numbers]
        listed = np.full(len(world) + 1, NO_PLANE, np.uint8)
        listed[numbers] = np.arange(len(numbers))
        shown[view] = listed[room.plane[quads[view]]]
    return out, kind, shown
