"""Room samples: rings, layouts and planes that agree with the room, and what a sensor sees."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fewview.errors import FewviewError
from fewview.geometry import se3
from fewview.synthetic import ceilings, handheld, ring, shell
from fewview.synthetic.classes import Ground, PlaneKind, Surface
from fewview.synthetic.floor_map import floor_map
from fewview.synthetic.frames import trace
from fewview.synthetic.handheld import look
from fewview.synthetic.plan import OpeningKind, make_plan, overlap_any, overlaps
from fewview.synthetic.ring_sensor import photograph_ring
from fewview.synthetic.room import Room, make_room
from fewview.synthetic.samples import GRID, GRID_CELL_M, NO_PLANE, RoomSample, room_sample
from fewview.synthetic.splits import split_seed
from fewview.synthetic.torch_rays import TorchCaster
from fewview.types import Array, BoolArray, FloatArray, Intrinsics

SEEDS = (1, 4, 6, 11)
SIZE = 32


@cache
def room_of(seed: int) -> Room:
    return make_room(seed)


@cache
def sample_of(seed: int) -> RoomSample:
    return room_sample(seed, views=4, size=SIZE)


def scene_of(corners: Array) -> o3d.t.geometry.RaycastingScene:
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    faces = 4 * np.arange(len(corners))[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    scene.add_triangles(
        o3d.core.Tensor(corners.reshape(-1, 3).astype(np.float32)),
        o3d.core.Tensor(faces.reshape(-1, 3).astype(np.uint32)),
    )
    return scene


def beams_to(room: Room, lamp: Array, count: int) -> FloatArray:
    """Rays (count, 6) of length 1 from random places in a room to a lamp."""
    rng = np.random.default_rng(0)
    low, high = room.plan.outline.min(axis=0), room.plan.outline.max(axis=0)
    start = rng.uniform([*low, 0.05], [*high, 1.5], (count, 3))
    return np.concatenate([start, lamp - start], axis=1).astype(np.float32)


def on_pillar(room: Room, points: Array) -> BoolArray:
    """Which of (n, 2) points are on or next to a pillar, whose sides are nobody's plane."""
    near = np.zeros(len(points), bool)
    for piece in room.standing:
        if piece.name == "column":
            middle = piece.footprint.mean(axis=0)
            reach = np.linalg.norm(piece.footprint - middle, axis=1).max()
            near |= np.linalg.norm(points - middle, axis=1) < reach + 0.02
    return near


def cell_of(points: Array) -> tuple[Array, Array]:
    """Row and column of level-frame points (n, 2 or 3), by the data contract."""
    row = np.floor((4.0 - points[:, 0]) / GRID_CELL_M).astype(int)
    column = np.floor((4.0 - points[:, 1]) / GRID_CELL_M).astype(int)
    return row, column


@pytest.mark.parametrize("seed", SEEDS)
def test_a_ring_pixel_lies_on_the_rooms_surface(seed: int) -> None:
    sample = sample_of(seed)
    assert (sample.depth > 0).all()
    level = ring.points(sample.depth).reshape(4, -1, 3).astype(np.float64)
    world = se3.transform(se3.inverse(sample.level_T_world), level).reshape(-1, 3)
    query = o3d.core.Tensor(world.astype(np.float32))
    off = scene_of(room_of(seed).corners).compute_distance(query).numpy()
    assert np.percentile(off, 99.9) < 1e-3 and off.max() < 0.02


@pytest.mark.parametrize("face", range(4))
def test_a_face_is_a_pinhole_view_left_front_right_back(face: int) -> None:
    seed, azimuth = 4, (90.0, 0.0, -90.0, 180.0)[face]
    sample = sample_of(seed)
    world_T_level = se3.inverse(sample.level_T_world[0])
    camera = world_T_level @ look(np.zeros(3), np.radians(azimuth), 0.0, 0.0)
    middle = 0.5 * (SIZE - 1)
    square = Intrinsics(SIZE, SIZE, 0.5 * SIZE, 0.5 * SIZE, middle, middle)
    hits = trace(room_of(seed), camera, square)
    part = (0, slice(None), slice(face * SIZE, (face + 1) * SIZE))
    np.testing.assert_allclose(sample.depth[part].ravel(), hits.depth, rtol=1e-4, atol=1e-4)
    normals = hits.normals @ sample.level_T_world[0, :3, :3].T
    close = np.abs(sample.normal[part].reshape(-1, 3) - normals).max(axis=-1) < 1e-4
    assert close.mean() > 0.99
    same = sample.semantics[part].ravel() == room_of(seed).surface[hits.quad]
    assert same.mean() > 0.99


@pytest.mark.parametrize("seed", SEEDS)
def test_normals_are_unit_and_face_the_camera(seed: int) -> None:
    sample = sample_of(seed)
    np.testing.assert_allclose(np.linalg.norm(sample.normal, axis=-1), 1.0, atol=1e-4)
    assert (np.einsum("vijk,ijk->vij", sample.normal, ring.rays(SIZE)) <= 1e-5).all()
    up = sample.normal[..., 2]
    assert (up[sample.semantics == Surface.FLOOR] > 0.99).all()
    assert (up[sample.semantics == Surface.CEILING] < -0.3).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_the_layout_agrees_with_the_plan(seed: int) -> None:
    sample, plan = sample_of(seed), room_of(seed).plan
    half = 0.5 * (GRID - 1)
    row, column = np.indices((GRID, GRID)).reshape(2, -1)
    level = np.stack([half - row, half - column, 0 * row], axis=-1) * GRID_CELL_M
    for pose, layout in zip(sample.level_T_world, sample.layout, strict=True):
        world = se3.transform(se3.inverse(pose), level)[:, :2]
        inside = np.logical_or.reduce([room.contains(world) for room in plan.rooms])
        deep = np.logical_and.reduce(
            [inside] + [
                np.logical_or.reduce([room.contains(world + shift) for room in plan.rooms])
                for shift in 0.06 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
            ]
        )  # fmt: skip
        found = layout.ravel()
        assert not (found[deep & ~on_pillar(room_of(seed), world)] == Ground.WALL).any()
        assert inside[np.isin(found, [Ground.FREE, Ground.FURNITURE])].mean() > 0.97
        middle = layout[GRID // 2 - 1 : GRID // 2 + 1, GRID // 2 - 1 : GRID // 2 + 1]
        assert (middle == Ground.FREE).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_the_layout_agrees_with_the_ring(seed: int) -> None:
    sample = sample_of(seed)
    points = ring.points(sample.depth)
    for view in range(4):
        seen = points[view].reshape(-1, 3)
        row, column = cell_of(seen)
        held = (row >= 1) & (row < GRID - 1) & (column >= 1) & (column < GRID - 1)
        classes = sample.semantics[view].ravel()
        around = np.stack([
            sample.layout[view][(row + i).clip(0, GRID - 1), (column + j).clip(0, GRID - 1)]
            for i in (-1, 0, 1) for j in (-1, 0, 1)
        ])  # fmt: skip
        floor = held & (classes == Surface.FLOOR)
        assert np.isin(around[4][floor], [Ground.FREE, Ground.FURNITURE]).mean() > 0.9
        upright = np.abs(sample.normal[view].reshape(-1, 3)[:, 2]) < 0.1
        wall = held & (classes == Surface.WALL) & upright
        assert np.isin(around[:, wall], [Ground.WALL, Ground.DOOR]).any(axis=0).mean() > 0.9
        solid = held & np.isin(classes, [Surface.CABINET, Surface.SOFA, Surface.BED])
        solid &= seen[:, 2] < 0.0
        if solid.any():
            assert (around[:, solid] == Ground.FURNITURE).any(axis=0).mean() > 0.8


@pytest.mark.parametrize("seed", SEEDS)
def test_planes_hold_the_pixels_of_walls_floor_and_ceiling(seed: int) -> None:
    sample = sample_of(seed)
    points = ring.points(sample.depth)
    kinds = {
        Surface.WALL: PlaneKind.WALL, Surface.FLOOR: PlaneKind.FLOOR,
        Surface.CEILING: PlaneKind.CEILING,
    }  # fmt: skip
    for view in range(4):
        for surface, kind in kinds.items():
            planes = sample.planes[view][sample.plane_kind[view] == kind]
            world = se3.transform(
                se3.inverse(sample.level_T_world[view]), points[view].reshape(-1, 3)
            )
            pillar = on_pillar(room_of(seed), world[:, :2]).reshape(SIZE, 4 * SIZE)
            of = (sample.semantics[view] == surface) & ~pillar
            if of.sum() < 200:
                continue
            off = np.abs(points[view][of] @ planes[:, :3].T - planes[:, 3])
            alike = sample.normal[view][of] @ planes[:, :3].T > 0.95
            assert ((off < 0.025) & alike).any(axis=1).mean() > 0.85
        used = sample.plane_kind[view] != PlaneKind.NONE
        np.testing.assert_allclose(np.linalg.norm(sample.planes[view][used, :3], axis=1), 1, 1e-5)
        assert not sample.planes[view][~used].any()


@pytest.mark.parametrize("seed", SEEDS)
def test_pixels_lie_on_the_planes_that_they_name(seed: int) -> None:
    sample = sample_of(seed)
    points = ring.points(sample.depth)
    for view in range(4):
        shown = sample.plane_id[view]
        on = shown != NO_PLANE
        assert (sample.plane_kind[view][shown[on]] != PlaneKind.NONE).all()
        planes = sample.planes[view][shown[on]]
        off = (points[view][on] * planes[:, :3]).sum(axis=-1) - planes[:, 3]
        alike = (sample.normal[view][on] * planes[:, :3]).sum(axis=-1)
        assert np.abs(off).max() < 0.03 and alike.min() > 0.99
        shell = np.isin(sample.semantics[view], [Surface.FLOOR, Surface.CEILING])
        assert on[shell].mean() > 0.8
        furniture = np.isin(sample.semantics[view], [Surface.SOFA, Surface.TABLE, Surface.CHAIR])
        assert not on[furniture].any()


@given(st.floats(0.2, 0.78), st.floats(0.2, 0.78))
@settings(max_examples=20, deadline=None)
def test_a_level_narrow_camera_looks_at_the_front_face(width: float, height: float) -> None:
    held = look(np.zeros(3), 0.0, 0.0, 0.0)[:3, :3].T
    inside, slope = ring.seen_by(held, (width, height), SIZE)
    row, column = np.nonzero(inside)
    assert column.min() >= SIZE and column.max() < 2 * SIZE
    assert row.min() + row.max() == SIZE - 1 and column.min() + column.max() == 3 * SIZE - 1
    reach = np.abs(np.arange(SIZE) - 0.5 * (SIZE - 1)) / (0.5 * SIZE)
    assert np.ptp(column) + 1 == (reach < np.tan(width)).sum()
    np.testing.assert_allclose(slope[inside], 1.0, atol=1e-6)


@given(st.floats(-0.6, 0.25), st.floats(-0.1, 0.1), st.floats(-3, 3))
@settings(max_examples=20, deadline=None)
def test_a_tilted_camera_sees_what_its_own_rays_hit(pitch: float, roll: float, yaw: float) -> None:
    """The mask in the ring equals projecting the ring's rays into the camera as it is held."""
    held = look(np.zeros(3), 0.0, pitch, roll)[:3, :3].T
    inside, _ = ring.seen_by(held, (0.5, 0.4), SIZE)
    ahead = held[2]
    middle = ring.rays(SIZE)[inside] @ ahead / np.linalg.norm(ring.rays(SIZE)[inside], axis=-1)
    assert middle.min() > np.cos(np.hypot(0.5, 0.4)) - 0.02
    elevation = np.arcsin(ahead[2])
    assert elevation == pytest.approx(pitch, abs=1e-9)
    rows = np.nonzero(inside)[0]
    assert (rows.mean() - 0.5 * (SIZE - 1)) * -pitch >= 0 or abs(pitch) < 0.1


@pytest.mark.parametrize("seed", SEEDS)
def test_measured_depth_is_near_the_truth_where_observed(seed: int) -> None:
    sample = sample_of(seed)
    assert not sample.measured[~sample.observed].any()
    seen = sample.measured > 0
    error = np.abs(sample.measured - sample.depth)[seen] / sample.depth[seen] ** 2
    assert np.percentile(error, 95) < 0.012
    assert 0.6 < seen.sum() / sample.observed.sum() < 1.0
    assert (sample.observed.mean(axis=(1, 2)) < 0.3).all()


def test_cameras_are_held_as_people_do() -> None:
    room = room_of(4)
    cameras = handheld.cameras(
        room.plan, floor_map(room, room.caster), 200, np.random.default_rng(0)
    )
    eyes = np.array([se3.inverse(c.level_T_world)[:3, 3] for c in cameras])
    assert (eyes[:, 2] >= 1.0).all() and (eyes[:, 2] <= 1.8).all() and np.ptp(eyes[:, 2]) > 0.7
    inside = np.logical_or.reduce([r.contains(eyes[:, :2]) for r in room.plan.rooms])
    assert inside.all()
    query = o3d.core.Tensor(eyes.astype(np.float32))
    assert scene_of(room.corners).compute_distance(query).numpy().min() > 0.2
    pitch = np.degrees([np.arcsin(c.scan_R_level[2, 2]) for c in cameras])
    assert pitch.min() > -35.01 and pitch.max() < 15.01 and np.ptp(pitch) > 40
    roll = np.degrees([np.arcsin(c.scan_R_level[0, 2]) for c in cameras])
    assert np.abs(roll).max() < 6.01
    heading = np.array([c.scan_R_level[2] for c in cameras])
    np.testing.assert_allclose(heading[:, 1], 0, atol=1e-9)
    assert (heading[:, 0] > 0).all()
    assert len({c.half_angles for c in cameras}) == 4


def test_a_room_without_floor_is_refused() -> None:
    room = room_of(4)
    above = floor_map(room, room.caster)
    above.cells[:] = Ground.FURNITURE
    with pytest.raises(FewviewError, match="no place to stand"):
        handheld.cameras(room.plan, above, 1, np.random.default_rng(0))


def test_same_seed_same_bytes_and_splits_differ() -> None:
    first, again = (room_sample(5, 2, 16) for _ in range(2))
    for name, value in vars(first).items():
        assert value.tobytes() == getattr(again, name).tobytes(), name
    rooms = [room_sample(split_seed(s, 0), 1, 16).depth.tobytes() for s in
             ("demo", "train", "validation", "test")]  # fmt: skip
    assert len(set(rooms)) == 4


def test_sight_ends_at_the_wall_and_goes_through_a_doorway() -> None:
    depth = np.full((SIZE, 4 * SIZE), 2.0, np.float32)
    depth[SIZE // 2, SIZE + SIZE // 2 - 2 : SIZE + SIZE // 2 + 2] = 6.0
    ways = np.array([[3.0, 0.0], [3.0, 1.5], [0.0, 3.0], [0.0, -3.0], [-3.0, 0.01]])
    far = ring.sight(depth, ways)
    np.testing.assert_allclose(far, [6.0, np.hypot(2, 1), 2, 2, 2], rtol=0.06)


@pytest.mark.parametrize("first", range(0, 60, 15))
def test_shells_of_all_shapes_are_closed(first: int) -> None:
    for seed in range(first, first + 15):
        rng = np.random.default_rng(seed)
        plan = make_plan(rng)
        surfaces = shell.shell(plan, rng, shell.Structure())
        scene = scene_of(np.concatenate([p.corners for p in surfaces]))
        for room in plan.rooms:
            middle = np.append(room.parts[0].mean(axis=0), 0.5)
            ways = rng.standard_normal((1000, 3))
            beams = np.concatenate([np.broadcast_to(middle, ways.shape), ways], axis=1)
            found = scene.cast_rays(o3d.core.Tensor(beams.astype(np.float32)))
            assert np.isfinite(found["t_hit"].numpy()).all(), seed


@given(st.integers(0, 10**6))
@settings(max_examples=60, deadline=None)
def test_plans_are_sound(seed: int) -> None:
    plan = make_plan(np.random.default_rng(seed))
    for number, room in enumerate(plan.rooms):

        def area(p: Array) -> float:
            return 0.5 * float(p[:, 0] @ np.roll(p[:, 1], -1) - p[:, 1] @ np.roll(p[:, 0], -1))

        assert sum(map(area, room.parts)) == pytest.approx(area(room.outline))
        assert 2.0 < room.height < 3.2
        for wall in room.walls:
            ends = [0.0, *(x for o in wall.openings for x in (o.left, o.right)), wall.length]
            assert (np.diff(ends) > 0).all()
            for o in wall.openings:
                x = np.linspace(o.left, o.right, 5)
                over = room.height_at(wall.to_world(np.stack([x, np.full(5, 0.01)], axis=-1)))
                assert over.min() > o.top
        others = [r.outline for r in plan.rooms[number + 1 :]]
        assert not any(overlap_any(other, room.parts) for other in others)
    passages = sum(o.kind is OpeningKind.PASSAGE for wall in plan.walls for o in wall.openings)
    assert passages == len(plan.neighbours)


@given(st.integers(0, 10**6))
@settings(max_examples=40, deadline=None)
def test_ceiling_faces_tile_the_room_at_its_height(seed: int) -> None:
    plan = make_plan(np.random.default_rng(seed))
    for planes, part in zip(plan.ceilings, plan.parts, strict=True):
        total = 0.0
        for _, corners in ceilings.faces(planes, part):
            flat = corners.reshape(-1, 3)
            np.testing.assert_allclose(ceilings.heights(planes, flat[:, :2]), flat[:, 2])
            a, b = (corners[:, i, :2] - corners[:, j, :2] for i, j in ((2, 0), (3, 1)))
            total += 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()
        a, b = part[2] - part[0], part[3] - part[1]
        assert total == pytest.approx(0.5 * abs(a[0] * b[1] - a[1] * b[0]))


@given(st.integers(0, 10**6))
def test_overlap_agrees_with_points_in_common(seed: int) -> None:
    rng = np.random.default_rng(seed)
    boxes = []
    for _ in range(2):
        size, angle = rng.uniform(0.2, 2, 2), rng.uniform(0, np.pi)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        corners = 0.5 * size * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        boxes.append(corners @ turn.T + rng.uniform(-1, 1, 2))
    weights = rng.dirichlet(np.full(4, 0.5), 3000)
    inside = weights @ boxes[0]
    edge = np.roll(boxes[1], -1, axis=0) - boxes[1]
    way = inside[:, None] - boxes[1]
    common = (edge[:, 0] * way[..., 1] - edge[:, 1] * way[..., 0] > 0.02).all(axis=1).any()
    assert overlaps(*boxes) or not common
    shifted = boxes[1] + [10.0, 0.0]
    assert not overlaps(boxes[0], shifted)


def test_coarse_textures_look_like_fine_ones() -> None:
    for texture in room_of(1).textures:
        fine, coarse = (texture.image(k).astype(float).mean(axis=(0, 1)) for k in (1.0, 4.0))
        assert np.abs(fine - coarse).mean() < 60
    means = [np.abs(t.image(1.0).astype(float).mean() - t.image(4.0).astype(float).mean())
             for t in room_of(1).textures]  # fmt: skip
    assert np.median(means) < 6


def test_torch_meets_what_embree_meets() -> None:
    room = room_of(6)
    beams = ring.beams(sample_of(6).level_T_world[:2], 12)
    ours, theirs = TorchCaster(room.corners).cast(beams), room.caster.cast(beams)
    np.testing.assert_allclose(ours.depth, theirs.depth, rtol=1e-3, atol=1e-3)
    same = ours.triangle == theirs.triangle
    assert same.mean() > 0.98
    np.testing.assert_allclose(ours.weights[same], theirs.weights[same], atol=2e-3)
    alike = room.surface[ours.triangle // 2] == room.surface[theirs.triangle // 2]
    assert alike.mean() > 0.99


def test_torch_sees_what_hides_a_lamp() -> None:
    room = room_of(6)
    start = beams_to(room, room.lamps[0], 400)
    ours, theirs = TorchCaster(room.corners).blocked(start), room.caster.blocked(start)
    assert (ours == theirs).mean() > 0.99
    assert 0.02 < theirs.mean() < 0.98


def test_torch_misses_what_is_not_there() -> None:
    square = np.array([[[0.0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], [[0.0, 0, 2]] * 4])
    ways = np.array(
        [[0.2, 0.6, 0, 0, 0, 2.0], [1.2, 0.5, 0, 0, 0, 1], [0.5, 0.5, 3, 0, 0, 1]], np.float32
    )
    met = TorchCaster(square).cast(ways)
    np.testing.assert_allclose(met.depth, [0.5, np.inf, np.inf])
    np.testing.assert_array_equal(met.triangle, [1, 0, 0])
    np.testing.assert_allclose(met.weights[0], [0.2, 0.4], atol=1e-6)
    np.testing.assert_array_equal(TorchCaster(square).blocked(ways), [True, False, False])


def test_samples_need_neither_open3d_nor_opencv() -> None:
    """As on an accelerator machine: geometry as with Open3D, colours without OpenCV."""
    code = """
import sys
for name in ("open3d", "cv2", "scipy"):
    sys.modules[name] = None
import importlib.util
import numpy as np
found = importlib.util.find_spec
importlib.util.find_spec = lambda name, *a: None if name == "cv2" else found(name, *a)
from fewview.synthetic.samples import room_sample
from fewview.synthetic.torch_rays import TorchCaster
sample = room_sample(6, 1, 8, TorchCaster)
np.savez(sys.argv[1], **vars(sample))
"""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sample.npz"
        subprocess.run([sys.executable, "-c", code, str(path)], check=True, timeout=120)
        bare = np.load(path)
        full = room_sample(6, 1, 8)
        np.testing.assert_allclose(bare["level_T_world"], full.level_T_world)
        assert (np.abs(bare["depth"] - full.depth) < 1e-2).mean() > 0.98
        assert (bare["semantics"] == full.semantics).mean() > 0.98
        assert (bare["layout"] == full.layout).mean() > 0.99
        apart = bare["colour"].astype(float).mean(axis=(0, 1, 2)) - full.colour.mean(axis=(0, 1, 2))
        assert np.abs(apart).max() < 60
        assert bare["colour"].std() > 10


def test_all_views_of_a_room_come_from_one_camera() -> None:
    picture = np.random.default_rng(0).uniform(20, 235, (8, 32, 3)).astype(np.float32)
    views = np.repeat(picture[None], 8, axis=0)
    shots = [photograph_ring(views, np.random.default_rng(seed)) for seed in range(24)]
    means = np.array([shot.mean(axis=(1, 2)) for shot in shots])
    tint = means / means.mean(axis=-1, keepdims=True)
    assert tint.std(axis=1).mean() < 0.7 * tint.mean(axis=1).std(axis=0).mean()
    assert means.std(axis=1).mean() > 1.0
    contrast = np.array([shot.std(axis=(1, 2, 3)) for shot in shots])
    assert contrast.std(axis=1).mean() < 0.4 * contrast.mean(axis=1).std()
