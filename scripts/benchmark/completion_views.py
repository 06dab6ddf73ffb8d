"""Views of rooms with the truth all around them: what completion is measured on.

Generated rooms come as the networks' own test split (`fewview.synthetic.samples`) with the noise,
tilts and lenses that they are trained on, levelled exactly. Real rooms come as their frames, made
into rings by fewview's own levelling, with the truth from their meshes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from benchmark.completion_mesh import MeshRoom
from benchmark.scenes import Scene
from fewview.completion.layout.points import ScanPoints, scan_points
from fewview.completion.panorama.ring import ring_points
from fewview.config import FeatureConfig
from fewview.geometry import se3
from fewview.geometry.camera import project
from fewview.synthetic import Library, Split, read_library
from fewview.synthetic.samples import RoomSample
from fewview.training.layout import turned_layout
from fewview.training.panorama import along_walls
from fewview.training.point_batches import FLOOR
from fewview.training.rooms import generated
from fewview.types import Array, BoolArray, FloatArray, Frame, Intrinsics, RingScan

SIZE = 64
"""Pixels along a ring's face."""
AS_SEEN = FeatureConfig(kinds=())
"""Settings under which no network is asked."""
Bytes = NDArray[np.uint8]


@dataclass(frozen=True)
class Truth:
    """What is really around a camera; S is `SIZE`, G the cells along a side of a layout.

    Attributes:
        depth: (S, 4 S) float32 of the ring, 0 unknown.
        normals: (S, 4 S, 3) float32, the ring's level frame, 0 unknown.
        semantics: (S, 4 S) uint8 of `panorama.CLASSES`, 0 unknown.
        in_view: (S, 4 S) inside the camera's field of view and range.
        ground: (G, G) uint8 of `layout.grid.CLASSES`.
        ground_known: (G, G) where that is known.
        doors_known: whether it tells doors from walls.
        grid_T_world: (4, 4) into the frame of `ground`.
        planes: (P, 4) structural planes, normal into the room and offset n . x = d, level frame.
        kinds: (P,) uint8 `PlaneKind`.
    """

    depth: FloatArray
    normals: FloatArray
    semantics: Bytes
    in_view: BoolArray
    ground: Bytes
    ground_known: BoolArray
    doors_known: bool
    grid_T_world: Array
    planes: Array
    kinds: Bytes

    @property
    def floor_z(self) -> float:
        """Height of the floor in the level frame, metres."""
        return float(self.planes[self.kinds == FLOOR, 3].min())


@dataclass(frozen=True)
class View:
    """One scan as the networks are given it, and the truth.

    Attributes:
        ring: the scan on its ring; points: those drawn from it.
        level_T_world: (4, 4) into the level frame of the ring.
        truth: what is really there.
    """

    ring: RingScan
    points: ScanPoints
    level_T_world: Array
    truth: Truth


class ViewSource(Protocol):
    """Where views come from: hashable, small, and it pickles."""

    @property
    def key(self) -> str:
        """A name for files that changes with the content."""

    def views(self) -> list[View]:
        """Views of one room."""


@dataclass(frozen=True)
class GeneratedRoom:
    """A room of a split seen by some cameras.

    Attributes:
        split, index: which room.
        count: number of cameras.
        library: folder of furniture models, see `synthetic.read_library`; procedural pieces alone
            when None.
    """

    split: Split
    index: int
    count: int
    library: Path | None = None

    @property
    def key(self) -> str:
        """See `ViewSource`."""
        models = _models(self.library)
        furnished = "" if models is None else f"-{models.fingerprint}"
        return f"{self.split}-{self.index:04d}-{self.count}{furnished}"

    def views(self) -> list[View]:
        """Views of the room."""
        models = _models(self.library)
        room = generated(self.split, self.index, self.count, SIZE, library=models)
        turned, rng = along_walls(room), np.random.default_rng(self.index)
        return [_generated_view(room, turned, v, rng) for v in range(self.count)]


@dataclass(frozen=True)
class SceneFrames:
    """Some frames of a scene that has a true mesh."""

    scene: Scene
    names: tuple[str, ...]

    @property
    def key(self) -> str:
        """See `ViewSource`."""
        return "~".join([self.scene.key, *self.names])

    def views(self) -> list[View]:
        """A view for each frame."""
        return [_frame_view(self.scene, name) for name in self.names]


@lru_cache(1)
def _models(folder: Path | None) -> Library | None:
    return None if folder is None else read_library(folder)


def groups_of(scene: Scene, count: int, seed: int) -> list[SceneFrames]:
    """The frames of a scene in random groups of ``count``, a rest of a single one left out."""
    order = np.random.default_rng(seed).permutation(len(scene.names))
    groups = [sorted(order[i : i + count]) for i in range(0, len(order), count)]
    return [SceneFrames(scene, tuple(scene.names[i] for i in g)) for g in groups if len(g) > 1]


def _generated_view(
    room: RoomSample, turned: RoomSample, view: int, rng: np.random.Generator
) -> View:
    """One camera of a room; ``turned``: the room `along_walls`."""
    level_T_world = turned.level_T_world[view]
    scan_T_level = se3.pose(room.scan_R_level[view], np.zeros(3))
    level_T_scan = level_T_world @ se3.inverse(scan_T_level @ room.level_T_world[view])
    measured = turned.measured[view]
    colour = turned.colour[view] * (measured > 0)[..., None]
    ring = RingScan(colour, measured, level_T_scan)
    points = scan_points(ring, rng)
    grid_T_world = _turned(points) @ level_T_world
    heading_R_world = room.level_T_world[view, :3, :3]
    layout = torch.from_numpy(room.layout[view].astype(np.int64))[None]
    ground, known = turned_layout(layout, grid_T_world[None, :3, :3] @ heading_R_world.T)
    there = room.plane_kind[view] > 0
    normals = room.planes[view, there, :3] @ heading_R_world @ level_T_world[:3, :3].T
    planes = np.column_stack([normals, room.planes[view, there, 3]])
    truth = Truth(
        depth=turned.depth[view],
        normals=turned.normal[view],
        semantics=turned.semantics[view],
        in_view=turned.observed[view],
        ground=ground[0].numpy().astype(np.uint8),
        ground_known=known[0].numpy(),
        doors_known=True,
        grid_T_world=grid_T_world,
        planes=planes.astype(np.float64),
        kinds=room.plane_kind[view, there],
    )
    return View(ring, points, level_T_world, truth)


def ring_of(frame: Frame) -> tuple[RingScan, ScanPoints]:
    """A frame on its ring as fewview levels it, and the points drawn from it."""
    from fewview.completion import complete

    ring = complete("scan", frame, 0, AS_SEEN, 0).room.ring
    return ring, scan_points(ring, np.random.default_rng(0))


def _frame_view(scene: Scene, name: str) -> View:
    frame = scene.load(name)
    ring, points = ring_of(frame)
    level_T_world = ring.level_T_scan @ se3.inverse(scene.truth[name])
    room = _mesh_room(scene)
    depth, normals = room.ring(level_T_world, SIZE)
    wall_T_world = _turned(points) @ level_T_world
    grid_T_world = room.upright(wall_T_world)
    ground, known = room.ground(grid_T_world)
    planes, kinds = room.planes_in(level_T_world)
    in_view = _in_view(depth, ring.level_T_scan, frame.intrinsics, AS_SEEN.max_depth_m)
    truth = Truth(
        depth=depth,
        normals=normals,
        semantics=np.zeros(depth.shape, np.uint8),
        in_view=in_view,
        ground=ground,
        ground_known=known,
        doors_known=False,
        grid_T_world=grid_T_world,
        planes=planes,
        kinds=kinds,
    )
    return View(ring, points, level_T_world, truth)


def _turned(points: ScanPoints) -> Array:
    """wall_T_level (4, 4)."""
    return se3.pose(points.wall_R_level.astype(np.float64), np.zeros(3))


@lru_cache(2)
def _mesh_room(scene: Scene) -> MeshRoom:
    mesh = scene.mesh()
    if mesh is None:
        raise SystemExit(f"{scene.folder} has no true mesh to measure completion against")
    return MeshRoom(mesh, scene.up)


def _in_view(
    depth: FloatArray, level_T_scan: Array, intrinsics: Intrinsics, max_depth_m: float
) -> BoolArray:
    """(S, 4 S) pixels of a true ring that lie in the camera's image and within reach."""
    points = se3.transform(se3.inverse(level_T_scan), ring_points(depth).astype(np.float64))
    _, inside = project(points.reshape(-1, 3), intrinsics)
    within = inside.reshape(depth.shape) & (depth > 0)
    return np.asarray(within & (points[..., 2] < max_depth_m))
