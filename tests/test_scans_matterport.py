"""Matterport3D: cameras that count from the bottom become ours."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from fewview import scans
from fewview.errors import ScanError
from fewview.geometry import camera, se3
from fewview.types import Array
from tests import scan_writers as w

WIDTH, HEIGHT = 160, 128
"""An eighth of the true 1280x1024, with the same view."""
INTRINSICS = (1076.45, 631.116, 1077.19, 509.202)
"""fx, cx, fy, cy of the whole image, the last from its lowest row upwards."""
POSES = [se3.exp(np.array([1.2, -0.4, 0.3 * i, 0.5 * i, 2.0, 1.4])) for i in range(3)]
"""Of cameras that look along -z with y up."""


def write_house(folder: Path, poses: list[Array] | None = None) -> Path:
    """A house of one panorama, images in an eighth of their size."""
    fx, cx, fy, cy = INTRINSICS
    lines = ["dataset matterport", "n_images 3", "depth_directory undistorted_depth_images"]
    lines += ["", f"intrinsics_matrix {fx} 0 {cx}  0 {fy} {cy} 0 0 1"]
    for i, pose in enumerate(POSES if poses is None else poses):
        depth, colour = f"a1b2_d0_{i}.png", f"a1b2_i0_{i}.jpg"
        raw = np.full((HEIGHT, WIDTH), 8000 + 400 * i, np.uint16)
        raw[:8] = 0
        raw[40, 100] = 6000
        w.put(folder / "undistorted_depth_images" / depth, w.encode(raw))
        ramp = w.encode(w.colour_ramp(WIDTH, HEIGHT), ".jpg")
        w.put(folder / "undistorted_color_images" / colour, ramp)
        lines.append(f"scan {depth} {colour} " + " ".join(f"{v:.9g}" for v in pose.ravel()))
    w.put(folder / "undistorted_camera_parameters" / "house.conf", "\n".join(lines) + "\n")
    return folder


def conf(folder: Path) -> Path:
    return folder / "undistorted_camera_parameters" / "house.conf"


def test_frames_come_back_in_metres(tmp_path: Path) -> None:
    found = scans.load(write_house(tmp_path))

    assert found.format == "matterport"
    assert [scan.name for scan in found.scans] == ["a1b2_i0_0", "a1b2_i0_1", "a1b2_i0_2"]
    assert found.depth_unit_m == pytest.approx(1 / 4000)
    frame = found.scans[1].load()
    assert frame.depth[64, 64] == pytest.approx(2.1) and frame.depth[4, 4] == 0.0
    difference = np.abs(frame.colour.astype(int) - w.colour_ramp(WIDTH, HEIGHT))
    assert difference.mean() < 2.0


def test_pixels_point_where_the_bottom_up_camera_says(tmp_path: Path) -> None:
    """The pixel (u, v) of the whole image lies at y = (1023 - v - cy) / fy in that camera."""
    fx, cx, fy, cy = INTRINSICS
    write_house(tmp_path)
    name, frame = "a1b2_i0_2", scans.load(tmp_path).scans[2].load()
    u, v = 8 * 100 + 3.5, 8 * 40 + 3.5
    bottom_up = 1.5 * np.array([(u - cx) / fx, (1023.0 - v - cy) / fy, -1.0])

    point = camera.backproject(frame.depth, frame.intrinsics)[40, 100].astype(np.float64)
    in_world = se3.transform(scans.truth(tmp_path)[name], point[None])

    np.testing.assert_allclose(in_world, se3.transform(POSES[2], bottom_up[None]), atol=1e-5)


def test_images_of_full_size_need_no_scaling(tmp_path: Path) -> None:
    write_house(tmp_path)
    whole = w.encode(np.full((1024, 1280), 8000, np.uint16))
    for path in (tmp_path / "undistorted_depth_images").iterdir():
        w.put(path, whole)
    for path in (tmp_path / "undistorted_color_images").iterdir():
        w.put(path, w.encode(w.colour_ramp(1280, 1024), ".jpg"))
    found = scans.load(tmp_path)
    assert found.scans[0].intrinsics.width == 640
    assert not any("scaled" in note for note in found.notes)


def test_part_of_a_house(tmp_path: Path) -> None:
    write_house(tmp_path)
    (tmp_path / "undistorted_depth_images" / "a1b2_d0_1.png").unlink()
    with pytest.raises(ScanError, match=r"a1b2_i0_1\.jpg has no partner .*a1b2_d0_1\.png"):
        scans.load(tmp_path)
    (tmp_path / "undistorted_color_images" / "a1b2_i0_1.jpg").unlink()

    assert [s.name for s in scans.load(tmp_path).scans] == ["a1b2_i0_0", "a1b2_i0_2"]
    assert list(scans.truth(tmp_path)) == ["a1b2_i0_0", "a1b2_i0_2"]
    assert any("1 of 3" in note for note in scans.load(tmp_path).notes)


def test_a_pose_that_is_not_finite_is_left_out(tmp_path: Path) -> None:
    write_house(tmp_path, [POSES[0], np.full((4, 4), -np.inf), POSES[2]])
    assert len(scans.load(tmp_path).scans) == 3
    assert list(scans.truth(tmp_path)) == ["a1b2_i0_0", "a1b2_i0_2"]


BROKEN = {
    "no camera": (r"intrinsics_matrix.*\n", "", "needs an intrinsics_matrix line above it"),
    "short camera": (r"0 0 1\n", "\n", "9 numbers, not 6"),
    "short pose": (r"(scan a1b2_d0_1.png a1b2_i0_1.jpg) \S+", r"\1", "with 16 numbers"),
    "a name twice": ("a1b2_i0_1", "a1b2_i0_0", "lists 'a1b2_i0_0' twice"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_parameters(case: str, tmp_path: Path) -> None:
    pattern, replacement, message = BROKEN[case]
    file = conf(write_house(tmp_path))
    w.put(file, re.sub(pattern, replacement, file.read_text(), count=1))
    with pytest.raises(ScanError, match=message) as caught:
        scans.load(tmp_path)
    assert "house.conf" in str(caught.value)


def test_no_parameters(tmp_path: Path) -> None:
    conf(write_house(tmp_path)).unlink()
    with pytest.raises(ScanError, match=r"holds 0 \.conf files"):
        scans.load(tmp_path)


def test_a_pose_that_is_no_motion(tmp_path: Path) -> None:
    write_house(tmp_path, [POSES[0], 2.0 * POSES[1], POSES[2]])
    with pytest.raises(ScanError, match=r"pose of a1b2_i0_1 in .*house\.conf"):
        scans.truth(tmp_path)
