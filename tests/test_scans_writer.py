"""What is written is read back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fewview import scans
from fewview.errors import ScanError
from fewview.types import Frame, Intrinsics
from tests import scan_writers as w

CAMERA = Intrinsics(64, 48, 60.123456789, 61.0 / 3.0 + 40.0, 31.25, 23.75)


def frames(count: int = 2) -> list[tuple[str, Frame]]:
    made = w.samples(count)
    return [
        (f"view-{i}", Frame(s.colour, (s.raw * np.float32(0.001)).astype(np.float32), CAMERA))
        for i, s in enumerate(made)
    ]


def test_read_back(tmp_path: Path) -> None:
    truth = {f"view-{i}": s.world_T_scan for i, s in enumerate(w.samples(2))}
    scans.write(tmp_path / "new", frames(), truth, colour_format="png")

    found = scans.load(tmp_path / "new")

    assert found.format == "7scenes" and found.depth_unit_m == 0.001
    for scan, (name, written) in zip(found.scans, frames(), strict=True):
        frame = scan.load()
        assert scan.name == name and frame.intrinsics == CAMERA
        np.testing.assert_array_equal(frame.colour, written.colour)
        np.testing.assert_array_equal(frame.depth, written.depth)
        np.testing.assert_allclose(scans.truth(tmp_path / "new")[name], truth[name], atol=1e-9)


def test_jpeg_is_close_and_the_default(tmp_path: Path) -> None:
    scans.write(tmp_path, frames())
    assert (tmp_path / "view-0.color.jpg").is_file() and not scans.truth(tmp_path)
    frame = scans.load(tmp_path).scans[1].load()
    assert np.abs(frame.colour.astype(int) - frames()[1][1].colour).max() <= 8


def test_unknown_depth_stays_unknown(tmp_path: Path) -> None:
    made = frames()
    made[0][1].depth[0, 10:15] = [np.nan, np.inf, -1.0, 70.0, 65.535]
    scans.write(tmp_path, made)
    depth = scans.load(tmp_path).scans[0].load().depth
    assert (depth[0, 10:15] == 0).all() and depth[0, 15] > 0


def test_writing_again_replaces(tmp_path: Path) -> None:
    scans.write(tmp_path, frames())
    before = sorted((p.name, p.read_bytes()) for p in tmp_path.iterdir())
    scans.write(tmp_path, frames())
    assert sorted((p.name, p.read_bytes()) for p in tmp_path.iterdir()) == before


def test_scans_of_others_are_not_mixed_in(tmp_path: Path) -> None:
    scans.write(tmp_path, frames(3))
    with pytest.raises(ScanError, match=r"view-2\..*choose an empty folder"):
        scans.write(tmp_path, frames(2))


def test_a_camera_left_by_another_scan_is_not_taken_over(tmp_path: Path) -> None:
    w.put(tmp_path / "view-0.intrinsics.txt", w.rows(w.CAMERA))
    with pytest.raises(ScanError, match=r"view-0\.intrinsics\.txt.*choose an empty folder"):
        scans.write(tmp_path, frames())


def test_nothing_half_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(self: Path, target: Path) -> Path:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(ScanError, match="No space left"):
        scans.write(tmp_path, frames())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["", "a/b", ".hidden", "a\\b"])
def test_names_that_are_no_file_names(name: str, tmp_path: Path) -> None:
    with pytest.raises(ScanError, match="plain file name"):
        scans.write(tmp_path, [(name, frames()[0][1])])


def test_cameras_must_agree(tmp_path: Path) -> None:
    made = frames()
    other = Frame(made[1][1].colour, made[1][1].depth, CAMERA.resized(32, 24))
    with pytest.raises(ScanError, match="another camera"):
        scans.write(tmp_path, [made[0], ("b", other)])


def test_a_file_in_the_way(tmp_path: Path) -> None:
    path = w.put(tmp_path / "taken", "")
    with pytest.raises(ScanError, match="taken cannot be written"):
        scans.write(path, frames())
