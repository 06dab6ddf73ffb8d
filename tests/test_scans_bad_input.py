"""Every bad input is one line that names the file and what to do."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from fewview import scans
from fewview.errors import ScanError
from tests import scan_writers as w


def message_of(path: Path, pixels: bool = False) -> str:
    """The error of loading ``path``, and of its pixels when ``pixels``."""
    with pytest.raises(ScanError) as caught:
        found = scans.load(path)
        assert pixels, "listing the scans should have failed"
        for scan in found.scans:
            scan.load()
    message = str(caught.value)
    assert "\n" not in message
    return message


def depth_file(folder: Path) -> Path:
    return folder / "frame-000001.depth.png"


def png_of(width: int, height: int, dtype: type, channels: int = 1) -> bytes:
    shape = (height, width) if channels == 1 else (height, width, channels)
    return w.encode(np.full(shape, 200, dtype))


DEPTH_FILES: dict[str, tuple[bytes, str]] = {
    "no bytes": (b"", "empty.*copy the file again"),
    "8 bit": (png_of(w.WIDTH, w.HEIGHT, np.uint8), "8 bits.*16-bit greyscale PNG"),
    "colour": (png_of(w.WIDTH, w.HEIGHT, np.uint8, 3), "3 channel.*16-bit greyscale PNG"),
    "16-bit colour": (png_of(w.WIDTH, w.HEIGHT, np.uint16, 3), "3 channel.*export"),
    "JPEG": (w.encode(np.zeros((w.HEIGHT, w.WIDTH), np.uint8), ".jpg"), "JPEG.*export"),
    "text": (b"hello", "neither a PNG nor a JPEG"),
    "only a signature": (b"\x89PNG\r\n\x1a\n", "corrupt"),
    "other shape": (png_of(32, 30, np.uint16), "intrinsics.txt is for 64x48.*32x30.*write"),
    "absurd size": (
        b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\x7f\xff\xff\xff\x7f\xff\xff\xff\x10\0\0\0\0" + bytes(8),
        "2147483647x2147483647.*corrupt",
    ),
}


@pytest.mark.parametrize("case", DEPTH_FILES)
def test_depth_file_of_the_wrong_kind(case: str, tmp_path: Path) -> None:
    content, expected = DEPTH_FILES[case]
    w.put(depth_file(w.write_seven_scenes(tmp_path)), content)
    message = message_of(tmp_path)
    assert "frame-000001.depth.png" in message and re.search(expected, message)


def test_depth_without_any_measurement(tmp_path: Path) -> None:
    for value in (0, 65535):
        made = w.samples(12)
        made[1].raw[:] = value
        message = message_of(w.write_seven_scenes(tmp_path, made), pixels=True)
        assert "frame-000001.depth.png is empty" in message and "remove this scan" in message


@pytest.mark.parametrize("kind", ["depth", "color"])
@pytest.mark.parametrize("damage", ["half", "flipped"])
def test_corrupt_png(
    kind: str, damage: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = w.write_seven_scenes(tmp_path, w.samples(12)) / f"frame-000001.{kind}.png"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    w.put(path, bytes(content if damage == "flipped" else content[: len(content) // 2]))

    message = message_of(tmp_path, pixels=True)

    assert path.name in message and "corrupt" in message and "copy the file again" in message
    assert capfd.readouterr().err == "", "a decoder wrote to the terminal"


def test_truncated_jpeg(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = w.write_redwood(tmp_path) / "color" / "00001.jpg"
    w.put(path, path.read_bytes()[:-40])
    assert "00001.jpg is corrupt" in message_of(tmp_path, pixels=True)
    assert capfd.readouterr().err == ""


def test_colour_of_16_bits(tmp_path: Path) -> None:
    w.write_seven_scenes(tmp_path)
    w.put(tmp_path / "frame-000001.color.png", depth_file(tmp_path).read_bytes())
    assert re.search(r"frame-000001\.color\.png has 16 bits.*export", message_of(tmp_path))


@pytest.mark.parametrize("size", [(32, 30), (48, 64)])
def test_colour_of_another_shape_than_its_depth(size: tuple[int, int], tmp_path: Path) -> None:
    w.write_seven_scenes(tmp_path)
    w.put(tmp_path / "frame-000001.color.png", w.encode(w.colour_ramp(*size)))
    expected = rf"frame-000001\.color\.png \({size[0]}x{size[1]}\).*64x48.*register colour"
    assert re.search(expected, message_of(tmp_path))


@pytest.mark.parametrize(
    ("layout", "missing", "named"),
    [
        ("7scenes", "frame-000001.depth.png", "frame-000001.color.png"),
        ("7scenes", "frame-000001.color.png", "frame-000001.depth.png"),
        ("scannet", "depth/10.png", "color/10.jpg"),
        ("scannet", "color/10.jpg", "depth/10.png"),
        ("redwood", "depth/00001.png", "color/00001.jpg"),
        ("redwood", "color/00001.jpg", "depth/00001.png"),
        ("tum", "depth/101.010000.png", "rgb/101.000000.png"),
        ("tum", "rgb/101.000000.png", "depth/101.010000.png"),
    ],
)
def test_half_a_pair(layout: str, missing: str, named: str, tmp_path: Path) -> None:
    (w.WRITERS[layout](tmp_path) / missing).unlink()
    message = message_of(tmp_path)
    assert named in message and "add it, or remove this file" in message


def test_redwood_folders_without_common_names_or_count(tmp_path: Path) -> None:
    w.write_redwood(tmp_path)
    for path in sorted((tmp_path / "color").iterdir()):
        path.rename(path.with_name("x" + path.name))
    (tmp_path / "color" / "x00001.jpg").unlink()
    assert "has no depth image of the same name" in message_of(tmp_path)


def test_doubled_names(tmp_path: Path) -> None:
    w.write_seven_scenes(tmp_path)
    w.put(tmp_path / "frame-000001.color.jpg", w.encode(w.colour_ramp(64, 48), ".jpg"))
    message = message_of(tmp_path)
    assert "frame-000001.color.jpg" in message and "frame-000001.color.png" in message
    assert "remove or rename" in message


def test_doubled_names_in_a_tum_list(tmp_path: Path) -> None:
    w.write_tum(tmp_path)
    for name in ("rgb", "depth"):
        path = tmp_path / f"{name}.txt"
        w.put(path, path.read_text().replace("\n102.0", "\n109.0") + path.read_text())
    assert re.search(
        r"rgb\.txt lists two images named '10\d\.000000': remove", message_of(tmp_path)
    )


CAMERAS: dict[str, tuple[str, str]] = {
    "NaN": ("60 0 nan 0 60 23.5 0 0 1", "NaN.*finite"),
    "inf": ("inf 0 31.5 0 60 23.5 0 0 1", "inf.*finite"),
    "words": ("fx 0 31.5 0 60 23.5 0 0 1", "not a number"),
    "too few": ("60 60 31.5 23.5", "4 numbers instead of the 9"),
    "nothing": ("", "0 numbers"),
    "binary": ("\x00\ufffd", "not a number"),
    "zero focal length": ("0 0 31.5 0 60 23.5 0 0 1", "must be positive"),
    "negative focal length": ("60 0 31.5 0 -60 23.5 0 0 1", "must be positive"),
    "not a camera": ("60 0 31.5 0 60 23.5 1 2 3", "third row"),
    "normalised": ("0.9 0 31.5 0 1.2 23.5 0 0 1", "in pixels"),
    "twice the size": (w.rows(w.camera_of_size(128, 96)), "another image size.*64x48"),
    "half the size": (w.rows(w.camera_of_size(32, 24)), "another image size.*64x48"),
}


@pytest.mark.parametrize("case", CAMERAS)
def test_camera_text(case: str, tmp_path: Path) -> None:
    content, expected = CAMERAS[case]
    w.put(w.write_seven_scenes(tmp_path) / "intrinsics.txt", content)
    message = message_of(tmp_path)
    assert "intrinsics.txt" in message and re.search(expected, message)


@pytest.mark.parametrize("case", CAMERAS)
def test_camera_text_of_one_scan(case: str, tmp_path: Path) -> None:
    content, expected = CAMERAS[case]
    w.put(w.write_seven_scenes(tmp_path) / "frame-000001.intrinsics.txt", content)
    message = message_of(tmp_path)
    assert "frame-000001.intrinsics.txt" in message and re.search(expected, message)


def test_the_folders_camera_is_missed_by_scans_without_one(tmp_path: Path) -> None:
    (w.write_seven_scenes(tmp_path) / "intrinsics.txt").unlink()
    w.put(tmp_path / "frame-000001.intrinsics.txt", w.rows(w.CAMERA))
    assert re.search(r"no camera intrinsics: write .*intrinsics\.txt", message_of(tmp_path))


def test_camera_text_that_is_not_text(tmp_path: Path) -> None:
    w.put(w.write_seven_scenes(tmp_path) / "intrinsics.txt", b"\xff\xfe\x00\x81")
    assert "intrinsics.txt is not a text file" in message_of(tmp_path)


JSON_CAMERAS: dict[str, tuple[str, str]] = {
    "no JSON": ("{", "not a camera file"),
    "a list": ("[1, 2]", "not a camera file"),
    "deep": ("[" * 100_000, "not a camera file"),
    "no matrix": ('{"width": 64, "height": 48}', "needs width, height and intrinsic_matrix"),
    "NaN": (json.dumps(w.camera_json(w.CAMERA * np.nan)), "NaN"),
    "other size": (json.dumps(w.camera_json(size=(640, 480))), "640x480.*another image size"),
    "negative scale": (json.dumps(w.camera_json() | {"depth_scale": -1}), "depth_scale"),
}


@pytest.mark.parametrize("case", JSON_CAMERAS)
def test_camera_json(case: str, tmp_path: Path) -> None:
    content, expected = JSON_CAMERAS[case]
    w.put(w.write_redwood(tmp_path) / "camera_intrinsic.json", content)
    message = message_of(tmp_path)
    assert "camera_intrinsic.json" in message and re.search(expected, message)


@pytest.mark.parametrize(
    ("layout", "file"),
    [
        ("7scenes", "intrinsics.txt"),
        ("tum", "intrinsics.txt"),
        ("redwood", "camera_intrinsic.json"),
        ("scannet", "intrinsic/intrinsic_depth.txt"),
    ],
)
def test_no_intrinsics(layout: str, file: str, tmp_path: Path) -> None:
    (w.WRITERS[layout](tmp_path) / file).unlink()
    message = message_of(tmp_path)
    assert re.search(r"write .*for example '525\.0 0 319\.5 ", message)
    assert Path(file).with_suffix(".txt").name in message or "intrinsics.txt" in message


def test_colour_camera_of_another_image_size(tmp_path: Path) -> None:
    w.write_scannet(tmp_path)
    camera = np.eye(4)
    camera[:3, :3] = w.camera_of_size(1296, 968)
    w.put(tmp_path / "intrinsic" / "intrinsic_color.txt", w.rows(camera))
    assert re.search(r"intrinsic_color\.txt.*64x48 colour", message_of(tmp_path))


def test_one_camera_cannot_serve_two_shapes(tmp_path: Path) -> None:
    w.write_seven_scenes(tmp_path, w.samples(colour_size=(128, 72)))
    assert re.search(r"128x72.*64x48.*register colour to depth", message_of(tmp_path))


@pytest.mark.parametrize("layout", w.WRITERS)
def test_one_scan_is_not_enough(layout: str, tmp_path: Path) -> None:
    writers: dict[str, Callable[[Path, list[w.Sample]], Path]] = {
        "7scenes": w.write_seven_scenes,
        "scannet": w.write_scannet,
        "sens": w.write_sens,
        "tum": w.write_tum,
        "redwood": w.write_redwood,
    }
    message = message_of(writers[layout](tmp_path, w.samples(1)))
    assert re.search(r"1 usable scan\(s\): at least 2", message) and str(tmp_path) in message


def test_too_many_scans(tmp_path: Path) -> None:
    w.put(tmp_path / "intrinsics.txt", w.rows(w.CAMERA))
    for i in range(1001):
        w.put(tmp_path / f"{i}.color.png", b"")
        w.put(tmp_path / f"{i}.depth.png", b"")
    assert "1001 scans: pick a subset of 5 to 20 (at most 1000)" in message_of(tmp_path)


def test_depth_that_no_unit_explains(tmp_path: Path) -> None:
    message = message_of(w.write_seven_scenes(tmp_path, w.samples(raw_per_metre=20.0)))
    assert str(tmp_path) in message and "in millimetres" in message


@pytest.mark.parametrize("unit", [0.0, -0.001, float("nan"), float("inf")])
def test_impossible_depth_unit(unit: float, tmp_path: Path) -> None:
    with pytest.raises(ScanError, match="positive number of metres"):
        scans.load(w.write_seven_scenes(tmp_path), depth_unit_m=unit)


def test_odd_depth_unit_is_noted(tmp_path: Path) -> None:
    found = scans.load(w.write_seven_scenes(tmp_path), depth_unit_m=0.01)
    assert any("unusual for a room" in note for note in found.notes)


def test_paths_that_hold_no_scans(tmp_path: Path) -> None:
    assert "does not exist" in message_of(tmp_path / "nowhere")
    assert "is empty: put scans" in message_of(tmp_path)
    w.put(tmp_path / "readme.txt", "hello")
    message = message_of(tmp_path)
    assert all(reader.LAYOUT in message for reader in scans.READERS)
    assert "not a file of scans" in message_of(tmp_path / "readme.txt")
    w.write_seven_scenes(tmp_path / "seq-01")
    assert f"did you mean {tmp_path / 'seq-01'}?" in message_of(tmp_path)


TUM_FILES: dict[str, tuple[str, str, str]] = {
    "no list": ("depth.txt", "", "no colour and depth image"),
    "time": ("rgb.txt", "noon rgb/a.png", "not a number"),
    "endless time": ("rgb.txt", "inf rgb/a.png", "timestamp is not finite"),
    "columns": ("depth.txt", "100.0", "'timestamp file'"),
}


@pytest.mark.parametrize("case", TUM_FILES)
def test_tum_lists(case: str, tmp_path: Path) -> None:
    name, content, expected = TUM_FILES[case]
    w.put(w.write_tum(tmp_path) / name, content)
    message = message_of(tmp_path)
    assert name in message and re.search(expected, message)


def test_a_missing_tum_list(tmp_path: Path) -> None:
    (w.write_tum(tmp_path) / "depth.txt").unlink()
    assert re.search(r"depth\.txt is missing: write", message_of(tmp_path))


POSES: dict[str, tuple[str, str, str]] = {
    "7scenes": ("frame-000001.pose.txt", "1 2 3", "3 numbers instead of the 16"),
    "scannet": ("pose/10.txt", w.rows(3.0 * np.eye(4)), "not a rigid"),
    "tum": ("groundtruth.txt", "100 0 0 0", "timestamp tx ty tz"),
    "redwood": ("trajectory.log", "0 0 1\n" + w.rows(np.eye(4)), "1 poses for 3 scans"),
}


@pytest.mark.parametrize("layout", POSES)
def test_bad_poses_only_matter_to_evaluation(layout: str, tmp_path: Path) -> None:
    file, content, expected = POSES[layout]
    w.put(w.WRITERS[layout](tmp_path) / file, content)
    assert len(scans.load(tmp_path).scans) == 3
    with pytest.raises(ScanError, match=expected) as caught:
        scans.truth(tmp_path)
    assert Path(file).name in str(caught.value)


def test_a_zero_quaternion(tmp_path: Path) -> None:
    w.put(w.write_tum(tmp_path) / "groundtruth.txt", "100 0 0 0 0 0 0 0")
    with pytest.raises(ScanError, match=r"groundtruth\.txt: a quaternion is zero"):
        scans.truth(tmp_path)


def test_orientation_tags_do_not_turn_colour(tmp_path: Path) -> None:
    """Depth is not turned either, so the two must stay as stored."""
    w.write_redwood(tmp_path)
    path = tmp_path / "color" / "00000.jpg"
    content = path.read_bytes()
    tiff = b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    exif = b"Exif\0\0" + tiff
    segment = b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif
    w.put(path, content[:2] + segment + content[2:])
    assert cv2.imread(str(path)).shape == (64, 48, 3), "the tag should work"
    assert scans.load(tmp_path).scans[0].load().colour.shape == (48, 64, 3)
