"""Fusion on analytic scenes: spheres and planes with exactly known depth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fewview.config import FusionConfig
from fewview.errors import FewviewError
from fewview.fusion import data_voxel, fuse, trusted_depth
from fewview.geometry import se3
from fewview.geometry.camera import backproject, project
from fewview.ply import read_ply, write_ply
from fewview.types import Array, ColouredMesh, FloatArray, Frame, Intrinsics

CAMERA = Intrinsics(160, 120, 130.0, 130.0, 79.5, 59.5)
HERE = np.eye(4)
CENTRE = np.array([0.1, -0.05, 1.5])
RADIUS = 0.4
CONFIG = FusionConfig(voxel_m=0.02)


def frame_of(depth: FloatArray, colour: tuple[int, int, int] = (200, 100, 50)) -> Frame:
    return Frame(np.full((*depth.shape, 3), colour, np.uint8), depth.astype(np.float32), CAMERA)


def wall(z: float) -> FloatArray:
    return np.full((CAMERA.height, CAMERA.width), z, np.float32)


def sphere_depth(world_T_scan: Array) -> FloatArray:
    """Depth of the sphere at CENTRE, 0 beside it."""
    rays = backproject(np.ones((CAMERA.height, CAMERA.width), np.float32), CAMERA)
    centre = se3.transform(se3.inverse(world_T_scan), CENTRE[None])[0]
    a, b = np.sum(rays**2, axis=-1), rays @ centre
    root = b**2 - a * (centre @ centre - RADIUS**2)
    return np.where(root > 0, (b - np.sqrt(np.maximum(root, 0.0))) / a, 0.0).astype(np.float32)


def around(angle: float) -> Array:
    """A camera turned by ``angle`` (rad) about the vertical line through CENTRE."""
    turn = se3.rotation_exp(np.array([0.0, angle, 0.0]))
    return se3.pose(turn, CENTRE - turn @ CENTRE)


def box_depth() -> FloatArray:
    """Depth inside a 3 x 2.4 x 3 m box, from its centre."""
    rays = backproject(np.ones((CAMERA.height, CAMERA.width), np.float32), CAMERA)
    return np.asarray(np.min(np.array([1.5, 1.2, 1.5]) / np.maximum(np.abs(rays), 1e-9), axis=-1))


def area(mesh: ColouredMesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def assert_same(a: ColouredMesh, b: ColouredMesh) -> None:
    assert a.vertices.tobytes() == b.vertices.tobytes()
    assert a.faces.tobytes() == b.faces.tobytes()
    assert a.colours.tobytes() == b.colours.tobytes()


def test_a_surface_seen_once_is_kept() -> None:
    mesh = fuse([(frame_of(sphere_depth(HERE)), HERE)], CONFIG)
    distance = np.linalg.norm(mesh.vertices - CENTRE, axis=1)
    assert np.abs(distance - RADIUS).max() < 0.015
    visible_cap = 2.0 * np.pi * RADIUS**2 * (1.0 - RADIUS / np.linalg.norm(CENTRE))
    assert 0.6 * visible_cap < area(mesh) < visible_cap
    assert np.array_equal(np.unique(mesh.colours, axis=0), [[200, 100, 50]])


def test_faces_look_at_the_camera() -> None:
    mesh = fuse([(frame_of(wall(1.5)), HERE)], CONFIG)
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    assert (np.cross(b - a, c - a)[:, 2] < 0.0).all()


def test_a_room_seen_once_has_all_the_walls_in_view() -> None:
    mesh = fuse([(frame_of(box_depth()), HERE)], CONFIG)
    assert np.abs(np.abs(mesh.vertices / [1.5, 1.2, 1.5]).max(axis=1) - 1.0).max() < 0.015
    points = backproject(box_depth(), CAMERA)
    assert mesh.vertices[:, 2].max() == pytest.approx(1.5, abs=0.005)
    for axis in (0, 1):
        low, high = points[..., axis].min(), points[..., axis].max()
        assert mesh.vertices[:, axis].min() == pytest.approx(low, abs=0.02)
        assert mesh.vertices[:, axis].max() == pytest.approx(high, abs=0.02)


def test_views_are_merged_in_the_world_frame() -> None:
    poses = [around(angle) for angle in (0.0, 1.2)]
    views = [(frame_of(sphere_depth(pose)), pose) for pose in poses]
    both, first = fuse(views, CONFIG), fuse(views[:1], CONFIG)
    assert np.abs(np.linalg.norm(both.vertices - CENTRE, axis=1) - RADIUS).max() < 0.02
    assert area(both) > 1.2 * area(first)


def test_colour_is_the_mean_of_the_views() -> None:
    views = [(frame_of(wall(1.5), (200, 0, 40)), HERE), (frame_of(wall(1.5), (100, 50, 40)), HERE)]
    mesh = fuse(views, CONFIG)
    assert np.array_equal(np.unique(mesh.colours, axis=0), [[150, 25, 40]])


def test_repeated_runs_give_the_same_bytes() -> None:
    poses = [around(angle) for angle in (-0.6, 0.0, 0.6)]
    noise = np.random.default_rng(0).normal(0.0, 0.004, (3, CAMERA.height, CAMERA.width))
    depths = [
        np.where(sphere_depth(p) > 0, sphere_depth(p) + n, 0)
        for p, n in zip(poses, noise, strict=True)
    ]
    meshes = [
        fuse([(frame_of(d), p) for d, p in zip(depths, poses, strict=True)], CONFIG)
        for _ in range(4)
    ]
    for mesh in meshes[1:]:
        assert_same(mesh, meshes[0])


def test_nothing_is_grown_between_a_near_object_and_the_wall() -> None:
    depth = wall(2.5)
    depth[40:80, 50:110] = 1.2
    mesh = fuse([(frame_of(depth), HERE)], CONFIG)
    z = mesh.vertices[:, 2]
    assert np.all((np.abs(z - 1.2) < 0.03) | (np.abs(z - 2.5) < 0.03))
    assert np.abs(z - 1.2).min() < 0.005 and np.abs(z - 2.5).min() < 0.005


def test_no_skirt_hangs_behind_a_silhouette_that_the_voxels_cannot_resolve() -> None:
    fine = CAMERA.resized(640, 480)
    depth = np.full((480, 640), 2.5, np.float32)
    depth[160:320, 200:440] = 1.2
    mesh = fuse([(Frame(np.zeros((480, 640, 3), np.uint8), depth, fine), HERE)], CONFIG)
    z = mesh.vertices[mesh.faces].mean(axis=1)[:, 2]
    assert np.all((np.abs(z - 1.2) < 0.03) | (np.abs(z - 2.5) < 0.03))


def test_pixels_beside_depth_edges_are_not_trusted() -> None:
    depth = wall(2.5)
    depth[:, 80:] = 1.2
    trusted = trusted_depth(frame_of(depth), max_depth_m=4.0)
    assert not trusted[:, 79:81].any()
    assert np.array_equal(trusted[:, :79], depth[:, :79])
    assert np.array_equal(trusted[:, 81:], depth[:, 81:])


def test_far_and_invalid_depth_is_not_trusted() -> None:
    depth = wall(2.0)
    depth[:, :20] = 5.0
    depth[:, 30:33] = np.nan
    depth[:, 40:43] = np.inf
    depth[:, 50:53] = -1.0
    trusted = trusted_depth(frame_of(depth), max_depth_m=4.5)
    assert set(np.unique(trusted)) == {0.0, 2.0}
    assert not trusted[:, [0, 19, 30, 31, 32, 40, 41, 42, 50, 51, 52]].any()


def test_pinholes_are_filled_and_nothing_else() -> None:
    rows = np.indices((CAMERA.height, CAMERA.width))[0]
    depth = (2.0 + 0.002 * rows).astype(np.float32)
    depth[:, 100:] = 3.0
    whole = depth.copy()
    pinholes = [(20, 20), (50, 40), (50, 41), (70, 60), (70, 61), (71, 60), (71, 61)]
    for v, u in pinholes:
        depth[v, u] = 0.0
    depth[30:33, 70:73] = np.nan
    depth[60, 98] = 0.0
    trusted = trusted_depth(frame_of(depth), max_depth_m=4.5)
    for v, u in pinholes:
        assert trusted[v, u] == pytest.approx(whole[v, u], abs=0.002)
    assert not trusted[30:33, 70:73].any()
    assert trusted[60, 98] == 0.0
    unchanged = np.ones(depth.shape, dtype=bool)
    unchanged[:, 98:102] = False
    unchanged &= depth > 0
    assert np.array_equal(trusted[unchanged], depth[unchanged])


def test_pepper_leaves_no_holes() -> None:
    pepper = np.random.default_rng(0).random((CAMERA.height, CAMERA.width)) < 0.005
    peppered = fuse([(frame_of(np.where(pepper, 0.0, wall(2.0))), HERE)], FusionConfig())
    whole = fuse([(frame_of(wall(2.0)), HERE)], FusionConfig())
    assert area(peppered) > 0.999 * area(whole)


def test_a_small_floater_goes_and_a_large_piece_stays() -> None:
    depth = np.zeros((CAMERA.height, CAMERA.width), np.float32)
    depth[:, 80:] = 2.0
    depth[10:14, 10:14] = 2.0
    depth[40:80, 10:60] = 2.0
    pixels, _ = project(fuse([(frame_of(depth), HERE)], CONFIG).vertices, CAMERA)
    u, v = pixels.T
    assert not np.any((u < 20) & (v < 20))
    assert np.any((u < 60) & (v > 40))


@pytest.mark.parametrize(("z", "side", "kept"), [(0.6, 70, True), (2.5, 16, False)])
def test_a_small_piece_stays_when_many_pixels_measured_it(z: float, side: int, kept: bool) -> None:
    """Both pieces are smaller than the least area, only the near one rests on many pixels."""
    camera = CAMERA.resized(640, 480)
    depth = np.full((480, 640), 3.0, np.float32)
    depth[:, :300] = 0.0
    depth[100 : 100 + side, 100 : 100 + side] = z
    assert (side * z / camera.fx) ** 2 < 0.01
    mesh = fuse([(Frame(np.zeros((480, 640, 3), np.uint8), depth, camera), HERE)], FusionConfig())
    assert bool(np.any(np.abs(mesh.vertices[:, 2] - z) < 0.03)) == kept


def test_the_memory_bound_enlarges_the_voxel() -> None:
    views = [(frame_of(wall(2.0)), HERE)]
    fine = fuse(views, CONFIG)
    coarse = fuse(views, replace(CONFIG, max_memory_mb=4))
    assert 0 < len(coarse.vertices) < len(fine.vertices) / 2
    assert area(coarse) == pytest.approx(area(fine), rel=0.1)


@given(z=st.floats(0.5, 5.0), focal=st.floats(100.0, 1500.0))
def test_the_voxel_follows_depth_and_resolution(z: float, focal: float) -> None:
    depths = np.full(10, z, np.float32)
    voxel = data_voxel(depths, focal)
    assert 0.004 <= voxel <= 0.05
    assert voxel >= min(0.05, 3.99 * z / focal)
    assert data_voxel(depths * 1.5, focal) >= voxel


def test_the_voxel_is_derived_when_none_is_given() -> None:
    views = [(frame_of(wall(2.0)), HERE)]
    derived = fuse(views, FusionConfig())
    assert_same(derived, fuse(views, FusionConfig(voxel_m=data_voxel(wall(2.0), CAMERA.fx))))


def test_no_usable_depth_gives_an_empty_mesh() -> None:
    mesh = fuse([(frame_of(wall(0.0)), HERE), (frame_of(wall(9.0)), HERE)], FusionConfig())
    assert mesh.vertices.shape == (0, 3)
    assert mesh.faces.shape == (0, 3)
    assert mesh.colours.shape == (0, 3)


def test_a_lone_pixel_gives_an_empty_mesh() -> None:
    depth = wall(0.0)
    depth[60, 80] = 1.0
    assert len(fuse([(frame_of(depth), HERE)], FusionConfig()).faces) == 0


def test_no_frames_is_an_error() -> None:
    with pytest.raises(ValueError, match="at least one"):
        fuse([], FusionConfig())


def test_ply_round_trip(tmp_path: Path) -> None:
    mesh = fuse([(frame_of(sphere_depth(HERE)), HERE)], CONFIG)
    path = tmp_path / "mesh.ply"
    write_ply(path, mesh)
    assert_same(read_ply(path), mesh)
    assert [p.name for p in tmp_path.iterdir()] == ["mesh.ply"]


def test_an_empty_mesh_round_trips(tmp_path: Path) -> None:
    mesh = fuse([(frame_of(wall(0.0)), HERE)], CONFIG)
    write_ply(tmp_path / "mesh.ply", mesh)
    assert_same(read_ply(tmp_path / "mesh.ply"), mesh)


def test_other_programs_read_the_ply(tmp_path: Path) -> None:
    import open3d as o3d

    mesh = fuse([(frame_of(sphere_depth(HERE)), HERE)], CONFIG)
    write_ply(tmp_path / "mesh.ply", mesh)
    other = o3d.io.read_triangle_mesh(str(tmp_path / "mesh.ply"))
    assert np.array_equal(np.asarray(other.vertices), mesh.vertices)
    assert np.array_equal(np.asarray(other.triangles), mesh.faces)
    assert np.array_equal(np.rint(np.asarray(other.vertex_colors) * 255), mesh.colours)


def test_a_file_cut_short_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "mesh.ply"
    write_ply(path, fuse([(frame_of(wall(2.0)), HERE)], CONFIG))
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(FewviewError, match=r"mesh\.ply"):
        read_ply(path)


def test_a_failed_write_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "mesh.ply"
    path.write_text("old")

    def full(self: Path, target: Path) -> Path:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(FewviewError, match="No space left"):
        write_ply(path, fuse([(frame_of(wall(2.0)), HERE)], CONFIG))
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_missing_folder_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(FewviewError, match=r"cannot write the mesh"):
        write_ply(tmp_path / "no" / "mesh.ply", fuse([(frame_of(wall(2.0)), HERE)], CONFIG))
