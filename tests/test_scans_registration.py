"""Colour of another size or camera lands on the depth camera's pixels."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fewview import scans
from fewview.geometry import se3
from fewview.scans.registration import Rig, register
from fewview.types import Intrinsics
from tests import scan_writers as w

DEPTH = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
COLOUR = Intrinsics(100, 80, 70.0, 72.0, 48.0, 41.0)


def test_one_camera_and_two_sizes_is_a_scaling(tmp_path: Path) -> None:
    found = scans.load(w.write_seven_scenes(tmp_path, w.samples(colour_size=(256, 192))))

    frame = found.scans[0].load()

    assert frame.colour.shape == (48, 64, 3)
    expected = w.colour_ramp(64, 48).astype(int)
    assert np.abs(frame.colour.astype(int) - expected).max() <= 2
    assert any("256x192" in note for note in found.notes)


@pytest.mark.parametrize("size", [(258, 192), (64, 48)])
def test_scannet_sizes(size: tuple[int, int], tmp_path: Path) -> None:
    frame = scans.load(w.write_scannet(tmp_path, w.samples(colour_size=size))).scans[0].load()
    difference = np.abs(frame.colour.astype(int) - w.colour_ramp(64, 48))
    assert difference.max() <= 8 and difference.mean() < 2


def test_points_take_the_colour_that_they_project_to() -> None:
    """A ramp of colour at known columns and rows makes each sampled pixel tell its place."""
    colour_T_depth = se3.exp(np.array([0.02, -0.05, 0.03, 0.1, -0.04, 0.02]))
    rig = Rig(DEPTH, DEPTH, COLOUR, colour_T_depth)
    rows, columns = np.indices((80, 100))
    image = np.stack([2 * columns, 3 * rows, 0 * rows], axis=-1).astype(np.uint8)
    depth = np.random.default_rng(0).uniform(1.0, 3.0, (48, 64)).astype(np.float32)
    depth[::3] = 0

    sampled = register(image, depth, rig).astype(float)

    for v, u in ((10, 20), (25, 33), (40, 50), (24, 31), (12, 40)):
        ray = np.linalg.solve(DEPTH.matrix, [u, v, 1.0])
        known = depth[v, u] > 0
        point = colour_T_depth[:3, :3] @ ray * (depth[v, u] if known else 1.0)
        point = point + known * colour_T_depth[:3, 3]
        x, y, _ = COLOUR.matrix @ point / point[2]
        np.testing.assert_allclose(sampled[v, u, :2], [2 * x, 3 * y], atol=1.0)


def test_every_pixel_has_a_colour() -> None:
    narrow = Intrinsics(64, 48, 90.0, 90.0, 31.5, 23.5)
    rig = Rig(DEPTH, DEPTH, narrow, np.eye(4))
    depth = np.zeros((48, 64), np.float32)
    assert (register(np.full((48, 64, 3), 200, np.uint8), depth, rig) == 200).all()


def test_extrinsics_are_camera_to_reference(tmp_path: Path) -> None:
    """Poses are of the reference; scans are of the depth camera."""
    w.write_scannet(tmp_path)
    reference_T_depth = se3.exp(np.array([0.0, 0.1, 0.0, 0.03, 0.0, 0.0]))
    w.put(tmp_path / "intrinsic" / "extrinsic_depth.txt", w.rows(reference_T_depth))

    truth = scans.truth(tmp_path)["10"]

    np.testing.assert_allclose(truth, w.samples()[1].world_T_scan @ reference_T_depth, atol=1e-9)
    assert any("resampled" in note for note in scans.load(tmp_path).notes)
    header = w.SensHeader(reference_T_depth=reference_T_depth)
    path = w.put(tmp_path / "scene.sens", w.sens_bytes(header=header))
    np.testing.assert_allclose(scans.truth(path)["frame-000001"], truth, atol=1e-6)


def test_extrinsics_common_to_both_cameras_move_no_colour(tmp_path: Path) -> None:
    w.write_scannet(tmp_path)
    for what in ("depth", "color"):
        path = tmp_path / "intrinsic" / f"extrinsic_{what}.txt"
        w.put(path, w.rows(se3.exp(np.array([0.0, 0.1, 0.2, 0.3, 0.0, 0.0]))))
    assert not any("resampled" in note for note in scans.load(tmp_path).notes)


def test_fine_texture_of_a_larger_colour_image_does_not_alias() -> None:
    large = DEPTH.resized(256, 192)
    rig = Rig(DEPTH, DEPTH, large, se3.exp(np.array([0.0, 0.0, 0.0, 0.01, 0.0, 0.0])))
    stripes = np.where(np.indices((192, 256))[1] % 2, 255, 0)
    image = np.repeat(stripes[..., None], 3, axis=2).astype(np.uint8)

    sampled = register(image, np.full((48, 64), 2.0, np.float32), rig)

    assert np.abs(sampled.astype(int) - 127).max() <= 2


def test_wide_depth_is_reduced_with_its_camera(tmp_path: Path) -> None:
    made = w.samples(2, colour_size=(1280, 960), depth_size=(1280, 960))
    w.write_seven_scenes(tmp_path, made)
    w.put(tmp_path / "intrinsics.txt", w.rows(w.camera_of_size(1280, 960)))

    found = scans.load(tmp_path)
    frame = found.scans[0].load()

    expected = w.camera_of_size(640, 480)
    np.testing.assert_allclose(frame.intrinsics.matrix, expected, atol=1e-9)
    assert (frame.intrinsics.width, frame.intrinsics.height) == (640, 480)
    assert frame.depth.shape == (480, 640) and frame.colour.shape == (480, 640, 3)
    assert set(np.unique(frame.depth)) <= set(np.unique(made[0].raw * np.float32(0.001)))
    assert np.abs(frame.colour.astype(int) - w.colour_ramp(640, 480)).max() <= 2
    assert any("reduced" in note and "640x480" in note for note in found.notes)


def test_camera_json_of_the_colour_images_is_scaled(tmp_path: Path) -> None:
    w.write_redwood(tmp_path, w.samples(colour_size=(128, 96)))
    camera = w.camera_json(w.camera_of_size(128, 96), (128, 96))
    w.put(tmp_path / "camera_intrinsic.json", json.dumps(camera))

    found = scans.load(tmp_path)

    np.testing.assert_allclose(found.scans[0].intrinsics.matrix, w.CAMERA, atol=1e-9)
    assert any("scaled to the depth images" in note for note in found.notes)
