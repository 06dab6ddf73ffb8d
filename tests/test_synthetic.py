"""Synthetic rooms: reproducible, furnished without collisions, seen from possible places, true."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fewview import scans, synthetic
from fewview.errors import FewviewError
from fewview.geometry import se3
from fewview.geometry.camera import backproject, project
from fewview.ply import read_ply
from fewview.synthetic import atlas, camera, furniture, sensor
from fewview.synthetic.plan import OpeningKind, overlaps
from fewview.synthetic.room import Room
from fewview.synthetic.textures import Texture
from fewview.synthetic.themes import THEMES
from fewview.types import Array, ColouredMesh

SEEDS = (1, 2, 8)
SMALL = synthetic.kinect(160, 120)
SPLITS = ("demo", "train", "validation", "test")
PIECES = sorted(
    {maker for theme in THEMES for maker in (*theme.along, *theme.middle, *theme.fillers)},
    key=lambda maker: maker.__name__,
)


@cache
def room_of(seed: int) -> Room:
    return synthetic.make_room(seed)


@cache
def views_of(seed: int, mode: str) -> tuple[Array, ...]:
    return tuple(synthetic.sample_views(room_of(seed), 5, 3, mode, SMALL))


def distances(mesh: ColouredMesh, points: Array) -> Array:
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(
        o3d.core.Tensor(mesh.vertices.astype(np.float32)),
        o3d.core.Tensor(mesh.faces.astype(np.uint32)),
    )
    query = o3d.core.Tensor(points.astype(np.float32))
    return np.asarray(scene.compute_distance(query).numpy(), np.float64)


def area(polygon: Array) -> float:
    x, y = polygon.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def test_same_seed_same_bytes_and_other_seeds_other_rooms() -> None:
    first, again, other, elsewhere = (
        synthetic.generate(room, 2, seed, "random", 96, 72)
        for room, seed in ((4, 0), (4, 0), (4, 1), (5, 0))
    )
    for a, b in zip(first.frames, again.frames, strict=True):
        assert a.colour.tobytes() == b.colour.tobytes()
        assert a.depth.tobytes() == b.depth.tobytes()
    assert first.mesh.vertices.tobytes() == again.mesh.vertices.tobytes()
    assert first.mesh.colours.tobytes() == again.mesh.colours.tobytes()
    assert first.mesh.vertices.tobytes() == other.mesh.vertices.tobytes()
    assert first.poses["scan-000"].tobytes() == again.poses["scan-000"].tobytes()
    assert first.poses["scan-000"].tobytes() != other.poses["scan-000"].tobytes()
    assert first.mesh.vertices.shape != elsewhere.mesh.vertices.shape


@pytest.mark.parametrize("seed", SEEDS)
def test_furniture_stands_inside_apart_and_out_of_doorways(seed: int) -> None:
    room = room_of(seed)
    assert len(room.standing) >= 3
    for i, piece in enumerate(room.standing):
        home = [r for r in room.plan.rooms if r.contains(piece.footprint).all()]
        assert len(home) == 1, piece.name
        assert 0 < piece.height < home[0].height
        for other in room.standing[:i]:
            assert not overlaps(piece.footprint, other.footprint), (piece.name, other.name)
    for wall in (w for r in room.plan.rooms for w in r.walls):
        for opening in wall.openings:
            if opening.kind is not OpeningKind.WINDOW:
                middle = [0.5 * (opening.left + opening.right), 0.5, 0.0]
                before = se3.transform(wall.world_T_wall, np.array([middle]))[:, :2]
                step = before + 0.2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
                assert not any(overlaps(step, p.footprint) for p in room.standing)


@pytest.mark.parametrize("make", PIECES)
def test_pieces_stand_on_the_floor_within_their_size(
    make: Callable[[np.random.Generator], furniture.Piece],
) -> None:
    piece = make(np.random.default_rng(3))
    points = np.concatenate([p.corners.reshape(-1, 3) for p in piece.patches])
    np.testing.assert_allclose(np.abs(points[:, :2]).max(axis=0), np.array(piece.size[:2]) / 2)
    assert points[:, 2].max() == pytest.approx(piece.size[2])
    assert -1e-9 <= points[:, 2].min() < 0.1


@pytest.mark.parametrize("seed", SEEDS)
def test_the_shell_is_closed_level_and_on_the_floor(seed: int) -> None:
    room = room_of(seed)
    vertices = room.mesh().vertices
    assert vertices[:, 2].min() == pytest.approx(0.0, abs=1e-9)
    assert vertices[:, 2].max() == pytest.approx(max(r.height for r in room.plan.rooms))
    assert sum(map(area, room.plan.parts)) == pytest.approx(area(room.plan.outline))
    middle = np.append(room.plan.parts[0].mean(axis=0), room.plan.height - 0.4)
    ways = np.random.default_rng(0).standard_normal((2000, 3))
    beams = np.concatenate([np.broadcast_to(middle, ways.shape), ways], axis=1)
    met = room.scene.cast_rays(o3d.core.Tensor(beams.astype(np.float32)))["t_hit"].numpy()
    assert np.isfinite(met).all()


@pytest.mark.parametrize("mode", ["random", "spread"])
@pytest.mark.parametrize("seed", SEEDS)
def test_cameras_are_hand_held_in_free_space(seed: int, mode: str) -> None:
    room, poses = room_of(seed), np.stack(views_of(seed, mode))
    rotations, places = poses[:, :3, :3], poses[:, :3, 3]
    np.testing.assert_allclose(rotations @ rotations.swapaxes(1, 2) - np.eye(3), 0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(rotations), 1)
    assert room.plan.contains(places[:, :2]).all()
    assert ((places[:, 2] >= 1.2) & (places[:, 2] <= 1.7)).all()
    assert distances(room.mesh(), places).min() > 0.4 - 1e-5
    pitch = np.degrees(np.arcsin(rotations[:, 2, 2]))
    assert ((pitch > -30.001) & (pitch < 5.001)).all()
    roll = np.degrees(np.arcsin(rotations[:, 2, 0] / np.cos(np.radians(pitch))))
    assert np.abs(roll).max() < 5.001
    assert (rotations[:, 2, 1] < 0).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_spread_views_share_little_and_hang_together(seed: int) -> None:
    room = room_of(seed)
    views = [camera.viewpoint(room, pose, SMALL) for pose in views_of(seed, "spread")]
    for i, view in enumerate(views[1:], start=1):
        shares = [camera.overlap(room, view, earlier, SMALL) for earlier in views[:i]]
        assert 0.15 <= max(shares) <= 0.40


@pytest.mark.parametrize("seed", SEEDS)
def test_noise_free_depth_lies_on_the_mesh(seed: int) -> None:
    room, pose = room_of(seed), views_of(seed, "random")[0]
    frame = synthetic.render(room, pose, SMALL)
    assert (frame.depth > 0).all()
    points = backproject(frame.depth, SMALL).reshape(-1, 3).astype(np.float64)
    assert distances(room.mesh(), se3.transform(pose, points)).max() < 1e-3


def test_a_surface_looks_alike_from_two_places() -> None:
    room, one = room_of(1), views_of(1, "random")[0]
    two = one @ se3.exp(np.array([0.02, 0.05, 0.03, 0.12, 0.02, -0.05]))
    first, second = (synthetic.render(room, pose, SMALL) for pose in (one, two))
    points = backproject(first.depth, SMALL).reshape(-1, 3).astype(np.float64)
    pixels, inside = project(se3.transform(se3.inverse(two) @ one, points), SMALL)
    x, y = np.rint(pixels[inside]).astype(int).T
    change = first.colour.reshape(-1, 3)[inside].astype(float) - second.colour[y, x]
    unrelated = first.colour.reshape(-1, 3)[inside].astype(float)[::-1] - second.colour[y, x]
    assert np.median(np.abs(change)) < 5 < 0.3 * np.median(np.abs(unrelated))


@pytest.mark.parametrize("depth_m", [1.0, 2.0, 4.0])
def test_depth_noise_grows_with_the_square_of_depth(depth_m: float) -> None:
    shape = (240, 320)
    flat = sensor.View(
        np.zeros((*shape, 3), np.float32),
        np.full(shape, depth_m, np.float32),
        np.ones(shape, np.float32),
    )
    measured = sensor.measure(flat, np.random.default_rng(0))
    seen = measured[measured > 0]
    assert 0.97 < seen.size / measured.size < 1
    assert seen.std() == pytest.approx(0.0014 * depth_m**2, rel=0.25)
    assert seen.mean() == pytest.approx(depth_m, abs=0.001 * depth_m**2)
    np.testing.assert_allclose(seen * 1000, np.rint(seen * 1000), atol=1e-3)


def test_depth_is_lost_out_of_range_at_borders_and_at_grazing_angles() -> None:
    depth = np.full((100, 400), 2.0, np.float32)
    depth[:, :50], depth[:, 50:100], depth[:, 200:] = 0.3, 5.2, 3.0
    cosine = np.ones_like(depth)
    cosine[:, 300:] = 0.08
    view = sensor.View(np.zeros((100, 400, 3), np.float32), depth, cosine)
    seen = sensor.measure(view, np.random.default_rng(0)) > 0
    assert not seen[:, :100].any()
    assert not seen[:, 300:].any()
    assert seen[:, 198:202].mean() < 0.6 < 0.9 < seen[:, 110:190].mean()


def test_the_atlas_mirrors_textures_and_averages_from_afar() -> None:
    stripes = np.zeros((16, 32, 3), np.uint8)
    stripes[:, 1::2] = 200
    marked = np.zeros((4, 8, 3), np.uint8)
    marked[1, 2] = 10, 20, 30
    packed = atlas.pack(
        [
            Texture((32, 16), 0.01, lambda _: stripes, np.zeros(3)),
            Texture((8, 4), 0.01, lambda _: marked, np.zeros(3)),
        ]
    )
    which, uv = np.array([1, 1, 1, 1, 0]), np.array([[2, 1], [13, 1], [18, 1], [2, 6], [9, 9]])
    footprint = np.array([1, 1, 1, 1, 8], np.float32)
    colours = packed.lookup(which, uv.astype(np.float32), footprint)
    assert (colours[:4] == [10, 20, 30]).all()
    np.testing.assert_allclose(colours[4], 100, atol=2)


@given(
    st.sampled_from(SPLITS), st.integers(0, 10**9 - 1),
    st.sampled_from(SPLITS), st.integers(0, 10**9 - 1),
)  # fmt: skip
def test_no_room_is_in_two_splits(a: synthetic.Split, i: int, b: synthetic.Split, j: int) -> None:
    same = synthetic.split_seed(a, i) == synthetic.split_seed(b, j)
    assert same == ((a, i) == (b, j))


@pytest.mark.parametrize("index", [-1, 10**9])
def test_rooms_outside_a_split_are_refused(index: int) -> None:
    with pytest.raises(FewviewError, match="does not exist"):
        synthetic.split_seed("train", index)


def test_written_scenes_are_read_back(tmp_path: Path) -> None:
    scene = synthetic.generate(synthetic.split_seed("test", 0), 2, 0, "random", 96, 72)
    synthetic.write(tmp_path / "room", scene)
    found = scans.load(tmp_path / "room")
    truth = scans.truth(tmp_path / "room")
    assert [s.name for s in found.scans] == list(scene.names)
    for scan, frame in zip(found.scans, scene.frames, strict=True):
        loaded = scan.load()
        np.testing.assert_array_equal(np.rint(loaded.depth * 1e3), np.rint(frame.depth * 1e3))
        assert np.abs(loaded.colour.astype(int) - frame.colour).mean() < 6
        np.testing.assert_allclose(truth[scan.name], scene.poses[scan.name], atol=1e-6)
    mesh = read_ply(tmp_path / "room" / "truth.ply")
    np.testing.assert_allclose(mesh.vertices, scene.mesh.vertices, atol=1e-5)
