"""Completed rooms in pictures, in space and in the recording."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rerun.chunk import RrdReader

from fewview.completion.layout import grid
from fewview.completion.panorama import CLASSES
from fewview.geometry import se3
from fewview.recording import Recorder, room_pictures, rooms, tables
from fewview.recording.layout import RING_TITLES
from fewview.recording.rooms import RoomShape, room_shape
from fewview.types import (
    Array,
    CompletedLayout,
    CompletedPanorama,
    CompletedPlanes,
    CompletedRoom,
    CompletedScan,
    Component,
    Frame,
    GlobalSolution,
    Intrinsics,
    Levelling,
    RingScan,
    Scan,
    ScanPlacement,
    ScanSet,
    StructuralPlane,
    Surface,
)
from tests.box_rooms import box_room

SIZE = 32
SAMPLE = box_room(3, 1, SIZE)
PLANES = SAMPLE.planes[0][:6].astype(np.float64)
"""Floor, ceiling and two pairs of opposite walls."""
KINDS = {1: "floor", 2: "ceiling", 3: "wall"}
LEVEL_T_SCAN = se3.pose(SAMPLE.scan_R_level[0].T, np.zeros(3))
NOTHING = np.zeros((0, 3), np.float32)
CAMERA = Intrinsics(40, 30, 30.0, 30.0, 19.5, 14.5)
NAMES = ("first", "second", "left over")


def _structure() -> CompletedPlanes:
    """The planes of the box room with their middles; the first wall is the one that is seen."""
    normals, offsets = PLANES[:, :3], PLANES[:, 3]
    middle = normals[::2].T @ (offsets[::2] - offsets[1::2]) / 2
    centres = middle + (offsets - normals @ middle)[:, None] * normals
    parts = zip(SAMPLE.plane_kind[0].tolist(), centres, normals, range(6), strict=False)
    planes = (
        StructuralPlane(KINDS[kind], centre, normal, NOTHING[:, 0], 0.9, i == 2)
        for kind, centre, normal, i in parts
    )
    return CompletedPlanes(tuple(planes), *(NOTHING,) * 4, NOTHING[:, 0])


def _room(size: int = SIZE) -> CompletedRoom:
    sample = box_room(3, 1, size)
    observed = sample.observed[0]
    colour = np.where(observed[..., None], sample.colour[0], np.uint8(0))
    panorama = CompletedPanorama(
        depth=sample.depth[0],
        normals=sample.normal[0],
        semantics=np.eye(12, dtype=np.float32)[sample.semantics[0]],
        descriptors=np.zeros((*observed.shape, 32), np.float32),
        confidence=np.where(observed, np.float32(1), np.float32(0.4)),
        observed=observed,
        level_T_scan=LEVEL_T_SCAN,
    )
    cells = np.eye(5, dtype=np.float32)[sample.layout[0]].transpose(2, 0, 1)
    seen = np.zeros((64, 64), bool)
    seen[:32] = True
    layout = CompletedLayout(
        LEVEL_T_SCAN,
        cells,
        sample.layout[0],
        np.zeros((64, 64, 32), np.float32),
        cells.max(axis=0),
        seen,
        np.array([0.0, 0.0, 1.0, -1.4]),
    )
    return CompletedRoom(
        RingScan(colour, sample.measured[0], LEVEL_T_SCAN), panorama, layout, _structure()
    )


@pytest.fixture(scope="module")
def room() -> CompletedRoom:
    return _room()


@pytest.fixture(scope="module")
def shape(room: CompletedRoom) -> RoomShape:
    return room_shape(room)


def test_a_ring_is_seen_above_completed(room: CompletedRoom) -> None:
    assert room.panorama is not None
    pictures = room_pictures.ring_pictures(room.ring, room.panorama)
    seen = room.panorama.observed
    np.testing.assert_array_equal(pictures.depth[:SIZE], room.ring.depth)
    np.testing.assert_array_equal(pictures.depth[-SIZE:], room.panorama.depth)
    np.testing.assert_array_equal(pictures.semantics[-SIZE:], SAMPLE.semantics[0])
    np.testing.assert_array_equal(pictures.semantics[:SIZE], SAMPLE.semantics[0] * seen)
    np.testing.assert_allclose(
        pictures.normals[-SIZE:] / 127.5 - 1.0, room.panorama.normals, atol=0.005
    )
    for above in (pictures.normals[:SIZE], pictures.confidence[:SIZE]):
        assert (above[~seen] == room_pictures.UNSEEN).all()
        assert (above[seen] != room_pictures.UNSEEN).any(axis=-1).all()
    np.testing.assert_array_equal(pictures.confidence[:SIZE][seen], room.ring.colour[seen])
    below = pictures.confidence[-SIZE:]
    assert len(np.unique(below[seen], axis=0)) == len(np.unique(below[~seen], axis=0)) == 1
    assert below[seen].sum(axis=-1).min() > below[~seen].sum(axis=-1).max()


def test_every_class_has_a_colour_of_its_own() -> None:
    for names, colours in (
        (CLASSES, rooms.CLASS_COLOURS),
        (grid.CLASSES, room_pictures.LAYOUT_COLOURS),
    ):
        assert len(names) == len(np.unique(colours, axis=0))


def test_the_printed_panorama_shows_every_class_of_the_room(room: CompletedRoom) -> None:
    assert room.panorama is not None
    picture = room_pictures.panorama_picture(room.ring, room.panorama)
    blank = replace(room.panorama, semantics=np.eye(12, dtype=np.float32)[0 * SAMPLE.semantics[0]])
    area = np.array(
        [
            [(image == colour).all(axis=-1).sum() for colour in rooms.CLASS_COLOURS]
            for image in (picture, room_pictures.panorama_picture(room.ring, blank))
        ]
    )
    shown = Counter(SAMPLE.semantics[0].ravel().tolist())
    shown.update(SAMPLE.semantics[0][SAMPLE.observed[0]].tolist())
    zoomed = [shown[i] * room_pictures.RING_ZOOM**2 for i in range(1, 12)]
    assert (area[0] - area[1])[1:].tolist() == zoomed


def test_what_a_layout_predicts_is_paler_than_what_is_seen(room: CompletedRoom) -> None:
    assert room.layout is not None
    picture = room_pictures.layout_picture(room.layout)
    middle = room_pictures.CELL_PX // 2
    cells = picture[middle :: room_pictures.CELL_PX, middle :: room_pictures.CELL_PX][:64]
    clear = np.ones((64, 64), bool)
    clear[24:40, 24:40] = False
    for kind in (grid.WALL, grid.FREE, grid.FURNITURE, grid.DOOR):
        full = room_pictures.LAYOUT_COLOURS[kind]
        mine = clear & (SAMPLE.layout[0] == kind)
        assert (cells[mine & room.layout.observed] == full).all()
        faint = cells[mine & ~room.layout.observed]
        assert (faint > full).all()
        assert len(np.unique(faint, axis=0)) <= 1


@pytest.mark.parametrize("azimuth", [0.0, 0.7, 1.6, 2.9, -2.2])
def test_the_camera_of_a_layout_points_where_it_looks(azimuth: float) -> None:
    ahead = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    level_R_scan = np.stack([np.cross([0, 0, -1.0], ahead), [0, 0, -1.0], ahead], axis=1)
    unknown = np.eye(5, dtype=np.float32)[np.zeros((64, 64), int)].transpose(2, 0, 1)
    layout = CompletedLayout(
        se3.pose(level_R_scan, np.zeros(3)),
        unknown,
        np.zeros((64, 64), np.uint8),
        np.zeros((64, 64, 32), np.float32),
        unknown[0],
        np.zeros((64, 64), bool),
        np.array([0.0, 0.0, 1.0, -1.4]),
    )
    picture = room_pictures.layout_picture(layout)[: 64 * room_pictures.CELL_PX]
    drawn = (picture == room_pictures.CAMERA_COLOUR).all(axis=-1)
    down, right = np.argwhere(drawn).T - 32 * room_pictures.CELL_PX
    along = -down * ahead[0] - right * ahead[1]
    aside = -down * ahead[1] + right * ahead[0]
    reach = room_pictures.CAMERA_CELLS * room_pictures.CELL_PX
    assert along.max() == pytest.approx(reach, abs=3)
    assert along.min() > -reach / 3
    assert abs(aside[along > 0.9 * reach].mean()) < 2


def test_predicted_points_lie_on_the_unseen_surfaces(shape: RoomShape) -> None:
    points = se3.transform(LEVEL_T_SCAN, shape.points.astype(float))
    gaps = np.abs(points @ PLANES[:, :3].T - PLANES[:, 3])
    assert gaps.min(axis=1).max() < 1e-4
    ceiling = SAMPLE.semantics[0] == CLASSES.index("ceiling")
    left = ~SAMPLE.observed[0] & ~ceiling
    assert len(points) == left[:: rooms.STRIDE, :: rooms.STRIDE].sum()
    assert not np.any(gaps[:, 1] < 1e-6)
    floor = gaps[:, 0] < 1e-4
    colours = np.unique(shape.point_colours[floor], axis=0).tolist()
    assert rooms.CLASS_COLOURS[CLASSES.index("floor")].tolist() in colours
    assert rooms.CLASS_COLOURS[CLASSES.index("wall")].tolist() not in colours


def test_rectangles_join_to_the_box(shape: RoomShape) -> None:
    corners = se3.transform(LEVEL_T_SCAN, shape.rectangles.reshape(-1, 3))
    touched = np.abs(corners @ PLANES[:, :3].T - PLANES[:, 3]) < 1e-5
    assert (touched.sum(axis=1) == 3).all()
    assert len({tuple(row) for row in touched.tolist()}) == 8
    a, b, c = corners.reshape(-1, 4, 3).swapaxes(0, 1)[:3]
    facing = np.einsum("ij,ij->i", np.cross(b - a, c - b), PLANES[:, :3])
    assert (facing > 0).all()


def test_a_wall_that_nothing_ends_is_bounded() -> None:
    planes = _structure().planes
    alone = rooms.rectangles(planes[:3])
    length = np.linalg.norm(alone[2, 1] - alone[2, 0])
    assert length == pytest.approx(2 * rooms.MAX_HALF_M)
    assert rooms.rectangles(planes[:2]).shape == (2, 4, 3)
    assert rooms.rectangles(()).shape == (0, 4, 3)


def test_the_summary_counts_walls(shape: RoomShape) -> None:
    empty = room_shape(CompletedRoom(RingScan(NOTHING, NOTHING, np.eye(4))))
    lines = tables.rooms({"a": shape, "b": empty}).splitlines()
    assert "| a | 1 | 3 | 2.50 m |" in lines
    assert not any(line.startswith("| b") for line in lines)
    assert tables.rooms({"b": empty}) == ""


class Pixels:
    """A frame source that has its frame."""

    def load(self) -> Frame:
        return Frame(np.zeros((30, 40, 3), np.uint8), np.ones((30, 40), np.float32), CAMERA)


def _record(path: Path, completed: CompletedRoom) -> None:
    """Two scans placed, one left over, all with the same room."""
    frame = Pixels().load()
    wall = np.random.default_rng(0).uniform(-1, 1, (50, 3))
    surface = Surface(wall, 0 * wall, wall.astype(np.float32), np.zeros(50, int))
    upright = Levelling(LEVEL_T_SCAN[:3, :3], 0.9, True, -1.4)
    with Recorder(path, view=False) as recorder:
        scans = tuple(Scan(name, CAMERA, Pixels()) for name in NAMES)
        recorder.started(ScanSet("7scenes", scans, 0.001))
        for i, name in enumerate(NAMES):
            size = (CAMERA.width, CAMERA.height)
            one = CompletedScan(
                name, size, 0, CAMERA, frame.depth, surface, (), upright, completed, {}
            )
            recorder.scan_completed(i, frame, one)
        recorder.solved(_solution())
        recorder.finished({})


def _solution() -> GlobalSolution:
    poses = {i: se3.pose(LEVEL_T_SCAN[:3, :3], np.array([i, 0.0, 1.4])) for i in (0, 1)}
    placed = tuple(ScanPlacement(NAMES[i], 0, pose, 0.9, None) for i, pose in poses.items())
    left = ScanPlacement(NAMES[2], None, None, 0.1, "nothing fits")
    return GlobalSolution((*placed, left), (Component((0, 1), "floor"),), {}, poses, ())


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory, room: CompletedRoom) -> Path:
    path = tmp_path_factory.mktemp("rooms") / "mesh.rrd"
    _record(path, room)
    return path


def _logged(path: Path) -> dict[str, dict[str, Any]]:
    """The last value of every component of every entity."""
    out: dict[str, dict[str, Any]] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        values = {
            name: batch.column(name).to_pylist()[-1] for name in batch.schema.names if ":" in name
        }
        out.setdefault(chunk.entity_path, {}).update(values)
    return out


def _views(path: Path) -> dict[str, set[str]]:
    """Names of the views by the entity they show."""
    reader = RrdReader(path)
    (blueprint,) = reader.blueprints()
    out: dict[str, set[str]] = {}
    for chunk in reader.stream(store=blueprint).to_chunks():
        batch = chunk.to_record_batch()
        if "ViewBlueprint:space_origin" in batch.schema.names:
            ((name,),) = batch.column("ViewBlueprint:display_name").to_pylist()
            ((origin,),) = batch.column("ViewBlueprint:space_origin").to_pylist()
            out.setdefault(origin.strip("/"), set()).add(name)
    return out


def _decoded(blob: Any) -> Array:
    return cv2.imdecode(np.array(blob[0], dtype=np.uint8), cv2.IMREAD_UNCHANGED)


def test_pictures_of_rooms_are_recorded(recording: Path, room: CompletedRoom) -> None:
    logged = _logged(recording)
    assert room.panorama is not None
    pictures = room_pictures.ring_pictures(room.ring, room.panorama)
    depth = logged["/rooms/first/depth"]
    np.testing.assert_allclose(
        _decoded(depth["EncodedDepthImage:blob"]) / 1000, pictures.depth, atol=6e-4
    )
    assert depth["EncodedDepthImage:depth_range"] == [[0.0, 1000 * room_pictures.FARTHEST_M]]
    semantics = logged["/rooms/first/semantics"]
    assert semantics["SegmentationImage:buffer"][0] == pictures.semantics.ravel().tolist()
    labels = [
        row["class_description"]["info"]["label"]
        for row in semantics["AnnotationContext:context"][0]
    ]
    assert tuple(labels) == CLASSES
    for name, picture in (("normals", pictures.normals), ("confidence", pictures.confidence)):
        image = _decoded(logged[f"/rooms/second/{name}"]["EncodedImage:blob"])
        np.testing.assert_array_equal(image[..., ::-1], picture)
    assert "/rooms/left over/layout" in {entity.replace("\\", "") for entity in logged}


def test_rooms_stand_where_their_scans_do(recording: Path, shape: RoomShape) -> None:
    logged = _logged(recording)
    for place in ("/world/scans/first", "/world/scans/second", "/unplaced/left\\ over"):
        assert logged[place]["Transform3D:translation"]
        below = logged[f"{place}/room/points"]
        np.testing.assert_allclose(below["Points3D:positions"], shape.points, atol=1e-5)
        for entity, count in (("seen_planes", 1), ("predicted_planes", 5)):
            strips = np.array(logged[f"{place}/room/{entity}"]["LineStrips3D:strips"])
            assert strips.shape == (count, 5, 3)
            np.testing.assert_array_equal(strips[:, 0], strips[:, -1])
            faces = np.array(logged[f"{place}/room/{entity}/faces"]["Mesh3D:vertex_positions"])
            np.testing.assert_array_equal(faces.reshape(count, 4, 3), strips[:, :4])


def test_rooms_have_views_of_their_own(recording: Path) -> None:
    views = _views(recording)
    assert views["world"] == {"Answer", "Rooms"}
    for name in NAMES:
        for picture in (*RING_TITLES, "layout"):
            assert views[f"rooms/{name}/{picture}".replace(" ", "\\ ")] == {name}


def test_the_answer_hides_rooms_and_the_rooms_hide_the_answer(recording: Path) -> None:
    reader = RrdReader(recording)
    (blueprint,) = reader.blueprints()
    hidden = [
        re.sub(r".*/overrides|/visualizers$", "", chunk.entity_path)
        for chunk in reader.stream(store=blueprint).to_chunks()
        if "EntityBehavior:visible" in chunk.to_record_batch().schema.names
    ]
    for name in NAMES[:2]:
        assert hidden.count(f"/world/scans/{name}/room") == 1
        assert hidden.count(f"/world/scans/{name}/points") == 1
    assert hidden.count("/world/components") == 1
    assert "/unplaced/left\\ over/room" in hidden


@pytest.mark.parametrize(
    ("kept", "pictures", "in_space"),
    [((), set(), False), (("layout",), {"layout"}, False), (("planes",), set(), True)],
)
def test_no_view_is_empty(
    tmp_path: Path, room: CompletedRoom, kept: tuple[str, ...], pictures: set[str], in_space: bool
) -> None:
    path = tmp_path / "mesh.rrd"
    missing = {part: None for part in ("panorama", "layout", "planes") if part not in kept}
    _record(path, replace(room, **missing))
    views = _views(path)
    assert {origin.split("/")[-1] for origin in views if origin.startswith("rooms/")} == pictures
    assert ("Rooms" in views["world"]) == in_space
    entities = set(_logged(path))
    assert {e.split("/")[-1] for e in entities if e.startswith("/rooms/")} == pictures
    assert any("/room/" in entity for entity in entities) == in_space


def test_a_noisy_room_is_small(tmp_path: Path) -> None:
    """Twenty scans that no image format can compress still add less than 15 MB."""
    full = _room(64)
    assert full.panorama is not None
    rng = np.random.default_rng(0)
    noisy = replace(
        full.panorama,
        depth=rng.uniform(0.5, 6, full.ring.depth.shape).astype(np.float32),
        normals=rng.uniform(-1, 1, full.panorama.normals.shape).astype(np.float32),
        semantics=rng.uniform(0, 1, full.panorama.semantics.shape).astype(np.float32),
        confidence=rng.uniform(0, 1, full.ring.depth.shape).astype(np.float32),
    )
    sizes = []
    for completed in (CompletedRoom(full.ring), replace(full, panorama=noisy)):
        _record(tmp_path / "mesh.rrd", completed)
        sizes.append((tmp_path / "mesh.rrd").stat().st_size)
    assert sizes[1] - sizes[0] < len(NAMES) * 15e6 / 20
