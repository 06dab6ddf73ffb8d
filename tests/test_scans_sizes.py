"""Folders whose images differ in size, orientation or camera."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from fewview import scans
from fewview.errors import ScanError
from fewview.geometry import camera, se3
from fewview.types import Array, Scan
from tests import scan_writers as w

OFF_CENTRE = np.array([[60.0, 0.0, 33.0], [0.0, 62.0, 20.0], [0.0, 0.0, 1.0]])
TURN = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""A point of the camera to the same point of the camera whose image `w.turned` gives."""

SINGLE_CAMERA = {"7scenes": 1000.0, "tum": 5000.0, "redwood": 1000.0}


def mixed(count: int, turned: set[int], raw_per_metre: float = 1000.0) -> list[w.Sample]:
    made = w.samples(count, raw_per_metre=raw_per_metre)
    return [w.turned(scan) if i in turned else scan for i, scan in enumerate(made)]


def write(layout: str, folder: Path, made: list[w.Sample], matrix: Array = w.CAMERA) -> Path:
    writers = {"7scenes": w.write_seven_scenes, "tum": w.write_tum, "redwood": w.write_redwood}
    writers[layout](folder, made)
    if layout == "redwood":
        w.put(folder / "camera_intrinsic.json", json.dumps(w.camera_json(matrix)))
    else:
        w.put(folder / "intrinsics.txt", w.rows(matrix))
    return folder


def cloud(scan: Scan) -> Array:
    """(H, W, 3) points of the scan."""
    frame = scan.load()
    assert frame.intrinsics == scan.intrinsics
    return camera.backproject(frame.depth, frame.intrinsics).astype(np.float64)


def note_of(folder: Path, piece: str) -> str:
    """The one note with ``piece``."""
    found = [note for note in scans.load(folder).notes if piece in note]
    assert len(found) == 1, found
    return found[0]


@pytest.mark.parametrize("layout", SINGLE_CAMERA)
def test_turned_images_show_the_same_points(layout: str, tmp_path: Path) -> None:
    unit = SINGLE_CAMERA[layout]
    upright = write(layout, tmp_path / "a", mixed(3, set(), unit), OFF_CENTRE)
    some_turned = write(layout, tmp_path / "b", mixed(3, {1}, unit), OFF_CENTRE)

    for i, (a, b) in enumerate(
        zip(scans.load(upright).scans, scans.load(some_turned).scans, strict=True)
    ):
        if i == 1:
            expected = np.rot90(cloud(a) @ TURN.T)
            colour = np.rot90(a.load().colour).astype(int)
        else:
            expected, colour = cloud(a), a.load().colour.astype(int)
        np.testing.assert_allclose(cloud(b), expected, atol=1e-6)
        assert np.abs(b.load().colour - colour).mean() < 2.0


def test_the_note_on_turned_images_is_one_line(tmp_path: Path) -> None:
    w.write_seven_scenes(tmp_path, mixed(12, {1, 3, 5, 7, 9}))
    note = note_of(tmp_path, "turned")
    assert "intrinsics.txt" in note and "48x64" in note and "counter-clockwise" in note
    assert note.endswith(": frame-000001, frame-000003, frame-000005 and 2 more")


def test_the_principal_point_outvotes_the_majority(tmp_path: Path) -> None:
    w.write_seven_scenes(tmp_path, mixed(4, {0, 1, 2}))
    found = scans.load(tmp_path).scans
    np.testing.assert_allclose(found[3].intrinsics.matrix, w.CAMERA)
    np.testing.assert_allclose(found[0].intrinsics.matrix, w.turned_camera())


def test_a_folder_of_portrait_images_may_hold_others(tmp_path: Path) -> None:
    w.write_seven_scenes(tmp_path, mixed(4, {0}))
    portrait = w.turned_camera()
    w.put(tmp_path / "intrinsics.txt", w.rows(portrait))
    found = scans.load(tmp_path).scans
    np.testing.assert_allclose(found[0].intrinsics.matrix, portrait)
    np.testing.assert_allclose(found[3].intrinsics.matrix, w.turned_camera(portrait, w.HEIGHT))


def test_all_images_may_be_turned(tmp_path: Path) -> None:
    w.write_seven_scenes(tmp_path, mixed(2, {0, 1}))
    for scan in scans.load(tmp_path).scans:
        np.testing.assert_allclose(scan.intrinsics.matrix, w.turned_camera())
    assert note_of(tmp_path, "turned").endswith("(48x64)"), "all scans, so none is named"


def test_the_majority_decides_where_the_principal_point_does_not(tmp_path: Path) -> None:
    """A point between the centres of two similar sizes suits both."""
    made = w.samples(5, (68, 51), (68, 51)) + w.samples(2, (64, 48), (64, 48))
    w.write_seven_scenes(tmp_path, made)
    w.put(tmp_path / "intrinsics.txt", w.rows(w.camera_of_size(66, 50)))
    found = scans.load(tmp_path).scans
    np.testing.assert_allclose(found[0].intrinsics.matrix, w.camera_of_size(66, 50))
    assert found[6].intrinsics.fx < found[0].intrinsics.fx


def test_images_of_the_same_shape_scale_the_camera(tmp_path: Path) -> None:
    made = w.samples(2) + w.samples(2, (128, 96), (128, 96)) + w.samples(1, depth_size=(32, 24))
    found = scans.load(w.write_seven_scenes(tmp_path, made))
    for scan, size in zip(found.scans, [(64, 48)] * 2 + [(128, 96)] * 2 + [(32, 24)], strict=True):
        np.testing.assert_allclose(scan.intrinsics.matrix, w.camera_of_size(*size))
        assert scan.load().colour.shape == (size[1], size[0], 3)
    note = note_of(tmp_path, "is scaled to the depth images")
    assert "64x48 to 128x96, 64x48 to 32x24" in note
    assert note.endswith("frame-000002, frame-000003, frame-000004")


def test_turned_and_smaller_at_once(tmp_path: Path) -> None:
    made = [*w.samples(2), w.turned(w.samples(1, (32, 24), (32, 24))[0])]
    found = scans.load(w.write_seven_scenes(tmp_path, made))
    expected = w.turned_camera(w.camera_of_size(32, 24), 32)
    np.testing.assert_allclose(found.scans[2].intrinsics.matrix, expected)


def test_large_images_are_reduced_alike_however_they_are_turned(tmp_path: Path) -> None:
    large = w.samples(2, (1280, 960), (1280, 960))
    w.write_seven_scenes(tmp_path, [large[0], w.turned(large[1])])
    w.put(tmp_path / "intrinsics.txt", w.rows(w.camera_of_size(1280, 960)))
    upright, turned = (scan.intrinsics for scan in scans.load(tmp_path).scans)
    assert (upright.width, upright.height) == (turned.height, turned.width) == (640, 480)
    np.testing.assert_allclose(
        turned.matrix, w.turned_camera(upright.matrix, upright.width), atol=1e-9
    )


def test_colour_turned_with_a_camera_of_its_own(tmp_path: Path) -> None:
    """The same pixels get the same colours, so the offset between the cameras turns along."""
    for name, turned in (("a", set[int]()), ("b", {1})):
        folder = w.write_scannet(tmp_path / name, mixed(3, turned))
        offset = se3.exp(np.array([0.0, 0.05, 0.02, 0.1, -0.03, 0.01]))
        w.put(folder / "intrinsic" / "extrinsic_color.txt", w.rows(offset))
    upright, other = (scans.load(tmp_path / name).scans[1] for name in "ab")

    expected = np.rot90(upright.load().colour).astype(int)

    assert np.abs(expected - np.rot90(w.colour_ramp(64, 48, 40))).max() > 3, "offset does nothing"
    difference = np.abs(other.load().colour - expected)
    assert np.quantile(difference, 0.99) <= 6 and difference.mean() < 2.0
    np.testing.assert_allclose(cloud(other), np.rot90(cloud(upright) @ TURN.T), atol=1e-6)


def test_a_camera_of_its_own_wins(tmp_path: Path) -> None:
    w.write_seven_scenes(tmp_path, mixed(3, {2}))
    own = np.array([[50.0, 0.0, 30.0], [0.0, 51.0, 25.0], [0.0, 0.0, 1.0]])
    w.put(tmp_path / "frame-000001.intrinsics.txt", w.rows(own))
    clockwise = np.array([[62.0, 0.0, 24.5], [0.0, 60.0, 31.5], [0.0, 0.0, 1.0]])
    w.put(tmp_path / "frame-000002.intrinsics.txt", w.rows(clockwise))

    found = scans.load(tmp_path)

    for scan, matrix in zip(found.scans, (w.CAMERA, own, clockwise), strict=True):
        np.testing.assert_array_equal(scan.intrinsics.matrix, matrix)
    assert "intrinsics of their own: frame-000001, frame-000002" in found.notes
    assert "intrinsics from intrinsics.txt" in found.notes
    assert not any("turned" in note for note in found.notes)


def test_a_camera_of_its_own_need_not_be_of_the_common_shape(tmp_path: Path) -> None:
    w.write_seven_scenes(tmp_path, w.samples(2) + w.samples(1, (50, 50), (50, 50)))
    own = np.array([[50.0, 0.0, 24.0], [0.0, 51.0, 25.0], [0.0, 0.0, 1.0]])
    w.put(tmp_path / "frame-000002.intrinsics.txt", w.rows(own))
    assert scans.load(tmp_path).scans[2].load().depth.shape == (50, 50)


def test_the_folder_needs_no_camera_when_all_scans_have_one(tmp_path: Path) -> None:
    (w.write_seven_scenes(tmp_path) / "intrinsics.txt").unlink()
    for i in range(3):
        matrix = w.CAMERA + np.diag([i, i, 0.0])
        w.put(tmp_path / f"frame-{i:06d}.intrinsics.txt", w.rows(matrix))
    found = scans.load(tmp_path)
    assert [scan.intrinsics.fx for scan in found.scans] == [60.0, 61.0, 62.0]
    assert not any("from intrinsics.txt" in note for note in found.notes)


def test_a_camera_without_scan_is_ignored(tmp_path: Path) -> None:
    w.put(w.write_seven_scenes(tmp_path) / "frame-000009.intrinsics.txt", "nan")
    assert "ignored" in note_of(tmp_path, "frame-000009.intrinsics.txt")
    assert scans.load(tmp_path).scans[0].intrinsics.fx == 60.0


def test_another_shape_names_file_and_remedy(tmp_path: Path) -> None:
    w.write_seven_scenes(tmp_path, w.samples(3) + w.samples(1, (64, 36), (64, 36)))
    with pytest.raises(ScanError) as caught:
        scans.load(tmp_path)
    expected = r"is for 64x48, but .*frame-000003\.depth\.png is 64x36: .*NAME\.intrinsics\.txt"
    assert re.search(expected, str(caught.value))


def test_only_depth_turned_is_refused(tmp_path: Path) -> None:
    made = w.samples(3)
    made[1] = w.Sample(made[1].colour, w.turned(made[1]).raw)
    with pytest.raises(ScanError, match=r"frame-000001\.color\.png \(64x48\).*\(48x64\) differ"):
        scans.load(w.write_seven_scenes(tmp_path, made))


@pytest.mark.parametrize("what", ["depth", "color"])
def test_one_image_turned_is_refused_with_two_cameras_too(what: str, tmp_path: Path) -> None:
    """The direction of the turn is not known, so colours could be upside down."""
    made = w.samples(3)
    turned = w.turned(made[1])
    colour, raw = (made[1].colour, turned.raw) if what == "depth" else (turned.colour, made[1].raw)
    made[1] = w.Sample(colour, raw)
    with pytest.raises(ScanError, match=rf"{what}/10\.\w+ is turned.*turn both alike"):
        scans.load(w.write_scannet(tmp_path, made))


def test_inspection_shows_the_camera_of_most_scans(tmp_path: Path) -> None:
    found = scans.inspect(w.write_seven_scenes(tmp_path, mixed(5, {0, 3})))
    assert found.depth_size == found.colour_size == (64, 48) and found.cameras == 2
    assert found.intrinsics.fx == 60.0
    assert "2 cameras" in found.text() and "frame-000000, frame-000003" in found.text()
