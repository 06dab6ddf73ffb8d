"""A box-shaped room with a door and one table, seen by upright cameras: exact and quick to make."""

from __future__ import annotations

import numpy as np

from fewview.completion.layout.grid import DOOR, FREE, FURNITURE, WALL, cell_centres
from fewview.completion.panorama.ring import ring_rays
from fewview.geometry import se3
from fewview.synthetic.samples import NO_PLANE, RoomSample
from fewview.types import Array

WALL_NORMALS = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
COLOURS = np.array([[0, 0, 0], [200, 180, 150], [90, 70, 50], [240, 240, 240], [120, 60, 30]])
TABLE_COLOUR = np.array([60, 90, 160])
HEIGHT_M = 2.5
EYE_M = 1.4


def box_room(seed: int, views: int = 2, size: int = 16) -> RoomSample:
    """A room of 3 to 6 m; each camera measures the 90 degrees ahead of it."""
    rng = np.random.default_rng(seed)
    half = rng.uniform(1.5, 3.0, 2)
    table = rng.uniform(-0.4, 0.4, 2) * half
    poses = [_level_T_world(rng, half) for _ in range(views)]
    parts = [_view(pose, half, table, size) for pose in poses]
    depth, normal, planes = (np.stack([p[i] for p in parts]).astype(np.float32) for i in range(3))
    semantics, layout, plane_id = (
        np.stack([p[i] for p in parts]).astype(np.uint8) for i in (3, 4, 5)
    )
    colour = np.where((semantics == 6)[..., None], TABLE_COLOUR, COLOURS[np.minimum(semantics, 4)])
    observed = np.zeros(depth.shape, bool)
    observed[:, :, size : 2 * size] = True
    kinds = np.tile(np.array([1, 2, 3, 3, 3, 3, 0], np.uint8), (views, 1))
    return RoomSample(
        level_T_world=np.stack(poses),
        scan_R_level=np.tile(np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]), (views, 1, 1)),
        colour=colour.astype(np.uint8),
        depth=depth,
        normal=normal,
        semantics=semantics,
        observed=observed,
        measured=np.where(observed, depth, 0).astype(np.float32),
        layout=layout,
        planes=planes,
        plane_kind=kinds,
        plane_id=plane_id,
    )


def _level_T_world(rng: np.random.Generator, half: Array) -> Array:
    eye = np.append(rng.uniform(-0.6, 0.6, 2) * half, EYE_M)
    turn = se3.rotation_exp(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]))
    return se3.inverse(se3.pose(turn, eye))


def _view(level_T_world: Array, half: Array, table: Array, size: int) -> tuple[Array, ...]:
    world_T_level = se3.inverse(level_T_world)
    rays = ring_rays(size).astype(np.float64)
    beams = rays @ world_T_level[:3, :3].T
    eye = world_T_level[:3, 3]
    normals, offsets, kinds = _planes(half)
    steps = (offsets - normals @ eye) / np.where(
        beams @ normals.T < -1e-9, beams @ normals.T, -1e-9
    )
    steps = np.where(steps > 0, steps, np.inf)
    hit = steps.argmin(axis=-1)
    depth = np.take_along_axis(steps, hit[..., None], axis=-1)[..., 0]
    points = eye + depth[..., None] * beams
    semantics = np.array([2, 3, 1, 1, 1, 1])[hit]
    semantics[(hit == 2) & _door(points)] = 4
    semantics[(hit == 0) & (np.abs(points[..., :2] - table) < 0.5).all(axis=-1)] = 6
    levelled = normals @ level_T_world[:3, :3].T
    planes = np.concatenate(
        [levelled, (offsets + levelled @ level_T_world[:3, 3])[:, None]], axis=1
    )
    planes = np.pad(planes, ((0, 1), (0, 0)))
    shown = np.where(semantics == 6, NO_PLANE, hit)
    return depth, levelled[hit], planes, semantics, _layout(world_T_level, half, table), shown


def _planes(half: Array) -> tuple[Array, Array, Array]:
    normals = np.concatenate([[[0.0, 0, 1], [0, 0, -1]], WALL_NORMALS])
    offsets = np.array([0.0, -HEIGHT_M, -half[0], -half[0], -half[1], -half[1]])
    return normals, offsets, np.array([1, 2, 3, 3, 3, 3])


def _door(points: Array) -> Array:
    return np.asarray((np.abs(points[..., 1]) < 0.45) & (points[..., 2] < 2.0))


def _layout(world_T_level: Array, half: Array, table: Array) -> Array:
    level = np.concatenate([cell_centres().reshape(-1, 2), np.zeros((64 * 64, 1))], axis=1)
    world = se3.transform(world_T_level, level)
    beyond = (np.abs(world[:, :2]) - half).max(axis=1)
    out = np.where(beyond < 0, FREE, np.where(beyond < 0.15, WALL, 0))
    door = (world[:, 0] < -half[0]) & (out == WALL) & (np.abs(world[:, 1]) < 0.45)
    out[door] = DOOR
    out[(np.abs(world[:, :2] - table) < 0.5).all(axis=1) & (out == FREE)] = FURNITURE
    return np.asarray(out.reshape(64, 64))
