"""Views with the truth around them: generated rooms and true meshes agree with themselves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmark import completion_views
from benchmark.completion_mesh import MeshRoom
from benchmark.completion_views import SIZE, GeneratedRoom, SceneFrames, View, groups_of
from benchmark.rooms import rooms
from benchmark.scenes import Scene
from fewview.completion.layout.grid import DOOR, FREE, FURNITURE, WALL, cell_centres, cells_of
from fewview.completion.panorama.ring import ring_points
from fewview.geometry import se3
from fewview.synthetic import Library
from fewview.synthetic.samples import RoomSample
from fewview.training.point_batches import CEILING, FLOOR
from fewview.training.point_batches import WALL as WALL_PLANE
from fewview.types import Array, ColouredMesh
from tests.box_rooms import box_room
from tests.furniture_library import write_library

HALF = np.array([2.0, 1.5])
HEIGHT, EYE = 2.5, 1.4
CABINET = (np.array([1.2, -1.5]), np.array([2.0, -0.9]), 1.2)


@pytest.fixture
def box_views(monkeypatch: pytest.MonkeyPatch) -> list[View]:
    def made(split: str, index: int, views: int, size: int, library: None) -> RoomSample:
        return box_room(index, views, size)

    monkeypatch.setattr(completion_views, "generated", made)
    return GeneratedRoom("test", 4, 3).views()


def quads(low: Array, high: Array, outwards: bool) -> Array:
    """(6, 4, 3) sides of an axis-aligned box with their front inside, or outside."""
    sides = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for end in (0, 1):
            corners = np.tile(np.where(np.arange(3) == axis, (low, high)[end], low), (4, 1))
            corners[[1, 2], u], corners[[2, 3], v] = high[u], high[v]
            sides.append(corners if (end == 1) == outwards else corners[::-1])
    return np.array(sides, np.float64)


def mesh_room(world_T_room: Array) -> MeshRoom:
    """A room with a low cabinet in a corner, z up, floor at 0, moved into some world."""
    room = quads(np.append(-HALF, 0.0), np.append(HALF, HEIGHT), outwards=False)
    low, high, top = CABINET
    cabinet = quads(np.append(low, 0.0), np.append(high, top), outwards=True)
    corners = np.concatenate([room, cabinet]).reshape(-1, 3)
    first = 4 * np.arange(len(corners) // 4)[:, None, None]
    faces = (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    vertices = se3.transform(world_T_room, corners)
    grey = np.full(vertices.shape, 128, np.uint8)
    return MeshRoom(ColouredMesh(vertices, faces, grey), world_T_room[:3, 2])


def level_T_room(x: float, y: float, azimuth: float) -> Array:
    turn = se3.rotation_exp(np.array([0.0, 0.0, azimuth]))
    return se3.inverse(se3.pose(turn, np.array([x, y, EYE])))


def test_a_scan_measured_what_is_there(box_views: list[View]) -> None:
    for view in box_views:
        seen = view.ring.depth > 0
        assert seen.mean() > 0.15 and not (seen & ~view.truth.in_view).any()
        np.testing.assert_allclose(view.ring.depth[seen], view.truth.depth[seen], rtol=1e-5)
        assert not view.ring.colour[~seen].any()


def test_true_planes_hold_the_true_ring(box_views: list[View]) -> None:
    for view in box_views:
        truth = view.truth
        flat = (truth.depth > 0) & np.isin(truth.semantics, (1, 2, 3, 4))
        points = ring_points(truth.depth)[flat]
        off = np.abs(points @ truth.planes[:, :3].T - truth.planes[:, 3])
        nearest = off.argmin(axis=1)
        assert np.quantile(off.min(axis=1), 0.95) < 0.03
        facing = (truth.planes[nearest, :3] * truth.normals[flat]).sum(axis=1)
        assert (facing > 0.999).mean() > 0.95
        assert truth.floor_z == pytest.approx(-1.4)


def test_the_true_layout_lies_under_the_true_ring(box_views: list[View]) -> None:
    import torch

    for view in box_views:
        truth = view.truth
        grid_T_level = truth.grid_T_world @ se3.inverse(view.level_T_world)
        points = ring_points(truth.depth)[truth.semantics == 2].astype(np.float64)
        cells, inside = cells_of(torch.from_numpy(se3.transform(grid_T_level, points)))
        under = truth.ground.ravel()[cells[inside].numpy()]
        assert (under == FREE).mean() > 0.9
    shown = np.concatenate([view.truth.ground for view in box_views])
    assert {FREE, WALL, FURNITURE, DOOR} <= set(np.unique(shown).tolist())


def test_views_of_a_room_share_a_world(box_views: list[View]) -> None:
    walls = []
    for view in box_views:
        world_T_level = se3.inverse(view.level_T_world)
        mine = view.truth.planes[view.truth.kinds == WALL_PLANE]
        normals = se3.rotate(world_T_level, mine[:, :3])
        walls.append(np.column_stack([normals, mine[:, 3] + normals @ world_T_level[:3, 3]]))
    np.testing.assert_allclose(walls[1], walls[0], atol=1e-4)
    np.testing.assert_allclose(walls[2], walls[0], atol=1e-4)


def test_a_library_furnishes_the_room(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    libraries: list[Library | None] = []

    def made(split: str, index: int, views: int, size: int, library: Library | None) -> RoomSample:
        libraries.append(library)
        return box_room(index, views, size)

    write_library(tmp_path)
    monkeypatch.setattr(completion_views, "generated", made)
    bare, furnished = GeneratedRoom("test", 4, 1), GeneratedRoom("test", 4, 1, tmp_path)
    assert len(bare.views()) == len(furnished.views()) == 1
    assert libraries[0] is None and libraries[1] is not None and libraries[1].of("test")
    assert bare.key != furnished.key


@pytest.fixture(scope="module")
def world_T_room() -> Array:
    turn = se3.rotation_exp(np.array([1.2, 0.3, -0.4]))
    return se3.pose(turn, np.array([5.0, -2.0, 1.0]))


@pytest.fixture(scope="module")
def room(world_T_room: Array) -> MeshRoom:
    return mesh_room(world_T_room)


def test_a_mesh_gives_the_ring_of_its_room(room: MeshRoom, world_T_room: Array) -> None:
    level_T_world = level_T_room(0.3, 0.2, 0.0) @ se3.inverse(world_T_room)
    depth, normals = room.ring(level_T_world, SIZE)
    row, face = SIZE // 2, SIZE // 2 + SIZE * np.arange(4)
    np.testing.assert_allclose(depth[row, face], [1.3, 1.7, 1.7, 2.3], atol=1e-3)
    np.testing.assert_allclose(normals[row, face[1]], [-1, 0, 0], atol=1e-4)
    np.testing.assert_allclose(normals[-1, face[3]], [0, 0, 1], atol=1e-4)
    assert (depth > 0).all()


def test_a_mesh_seen_from_its_back_is_unknown(room: MeshRoom, world_T_room: Array) -> None:
    depth, normals = room.ring(level_T_room(9.0, 0.0, 0.0) @ se3.inverse(world_T_room), SIZE)
    assert (depth > 0).mean() < 0.001
    assert not normals[depth == 0].any()


def test_a_mesh_gives_structural_planes(room: MeshRoom, world_T_room: Array) -> None:
    planes, kinds = room.planes_in(level_T_room(0.3, 0.2, 0.0) @ se3.inverse(world_T_room))
    assert sorted(kinds.tolist()) == sorted([FLOOR, CEILING] + [WALL_PLANE] * 4)
    found = {tuple(np.round(p[:3]).astype(int).tolist()): p[3] for p in planes}
    expected = {
        (0, 0, 1): -EYE,
        (0, 0, -1): EYE - HEIGHT,
        (1, 0, 0): -2.3,
        (-1, 0, 0): -1.7,
        (0, 1, 0): -1.7,
        (0, -1, 0): -1.3,
    }
    assert found == pytest.approx(expected, abs=0.02)


def test_a_mesh_gives_the_map_of_its_room(room: MeshRoom, world_T_room: Array) -> None:
    level_T_here = level_T_room(0.3, 0.2, 0.5)
    tilt = se3.pose(se3.rotation_exp(np.array([0.04, 0.03, 0.0])), np.zeros(3))
    tilted = tilt @ level_T_here @ se3.inverse(world_T_room)
    grid_T_world = room.upright(tilted)
    np.testing.assert_allclose(grid_T_world @ world_T_room, level_T_here, atol=5e-3)
    ground, known = room.ground(grid_T_world)
    assert ((ground != 0) == known).all()
    level = np.pad(cell_centres().astype(np.float64), ((0, 0), (0, 0), (0, 1)))
    there = se3.transform(se3.inverse(level_T_here), level)[..., :2]
    beyond = (np.abs(there) - HALF).max(axis=-1)
    low, high, _ = CABINET
    inside = ((there > low + 0.1) & (there < high - 0.1)).all(axis=-1)
    apart = ~((there > low - 0.1) & (there < high + 0.1)).all(axis=-1)
    assert (ground[(beyond > 0.03) & (beyond < 0.12)] == WALL).mean() > 0.9
    assert (ground[(beyond < -0.05) & apart] == FREE).mean() > 0.98
    edge = np.minimum(there - low, high - there).min(axis=-1)
    assert (ground[inside & (edge < 0.2)] == FURNITURE).mean() > 0.9
    assert not known[beyond > 0.2].any()


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return rooms("validation", 1, 2, tmp_path_factory.mktemp("rooms"), size=(320, 240), jobs=1)[0]


def test_frames_of_a_scene_measure_their_mesh(scene: Scene) -> None:
    (group,) = groups_of(scene, 4, 0)
    assert set(group.names) == set(scene.names)
    (view,) = SceneFrames(scene, group.names[:1]).views()
    truth, both = view.truth, (view.ring.depth > 0) & (view.truth.depth > 0)
    assert both.mean() > 0.03
    assert np.median(np.abs(view.ring.depth - truth.depth)[both]) < 0.03
    assert truth.in_view[view.ring.depth > 0].mean() > 0.8
    assert {FLOOR, WALL_PLANE} <= set(truth.kinds.tolist())


def test_groups_use_every_frame_once(scene: Scene) -> None:
    many = Scene(scene.folder, tuple(f"frame-{i}" for i in range(9)))
    groups = groups_of(many, 4, 1)
    assert [len(g.names) for g in groups] == [4, 4]
    assert len({name for g in groups for name in g.names}) == 8
    assert len({g.key for g in groups}) == 2
