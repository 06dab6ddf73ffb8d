"""Every layout is recognised and gives back what was written."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pytest

from fewview import scans
from fewview.errors import ScanError
from fewview.geometry import se3
from fewview.types import Intrinsics
from tests import scan_writers as w

UNITS = {"7scenes": 1000, "scannet": 1000, "sens": 1000, "tum": 5000, "redwood": 1000}
NAMES = {
    "7scenes": ["frame-000000", "frame-000001", "frame-000002"],
    "scannet": ["0", "10", "20"],
    "sens": ["frame-000000", "frame-000001", "frame-000002"],
    "tum": ["100.000000", "101.000000", "102.000000"],
    "redwood": ["00000", "00001", "00002"],
}


@pytest.mark.parametrize("layout", w.WRITERS)
def test_pixels_and_camera_come_back(layout: str, tmp_path: Path) -> None:
    found = scans.load(w.WRITERS[layout](tmp_path))

    assert found.format == layout
    assert [scan.name for scan in found.scans] == NAMES[layout]
    assert found.depth_unit_m == pytest.approx(1 / UNITS[layout])
    for scan, written in zip(found.scans, w.samples(raw_per_metre=UNITS[layout]), strict=True):
        frame = scan.load()
        assert frame.intrinsics == scan.intrinsics
        assert scan.intrinsics == Intrinsics(w.WIDTH, w.HEIGHT, 60.0, 62.0, 31.5, 23.5)
        assert frame.colour.dtype == np.uint8 and frame.depth.dtype == np.float32
        np.testing.assert_allclose(frame.depth, written.raw / UNITS[layout], rtol=1e-6)
        difference = np.abs(frame.colour.astype(int) - written.colour)
        assert difference.mean() < 2.0, "colour is not RGB or not where it was"


@pytest.mark.parametrize("layout", w.WRITERS)
def test_poses_come_back_only_as_truth(layout: str, tmp_path: Path) -> None:
    folder = w.WRITERS[layout](tmp_path)

    truth = scans.truth(folder)

    assert list(truth) == NAMES[layout]
    for name, written in zip(NAMES[layout], w.samples(), strict=True):
        np.testing.assert_allclose(truth[name], written.world_T_scan, atol=1e-6)
        rotation = truth[name][:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("layout", sorted(w.WRITERS.keys() - {"sens"}))
def test_poses_change_nothing_that_is_read(layout: str, tmp_path: Path) -> None:
    folder = w.WRITERS[layout](tmp_path)
    before = scans.load(folder)
    for pattern in ("groundtruth.txt", "trajectory.log", "*.pose.txt", "pose/*.txt"):
        for path in folder.glob(pattern):
            path.unlink()

    after = scans.load(folder)

    assert scans.truth(folder) == {}
    assert after.notes == before.notes
    assert [s.name for s in after.scans] == [s.name for s in before.scans]


@pytest.mark.parametrize("layout", w.WRITERS)
def test_scans_travel_between_processes(layout: str, tmp_path: Path) -> None:
    scan = scans.load(w.WRITERS[layout](tmp_path)).scans[1]
    copy = pickle.loads(pickle.dumps(scan))
    np.testing.assert_array_equal(copy.load().colour, scan.load().colour)


def test_a_sens_file_can_be_named_itself(tmp_path: Path) -> None:
    path = w.put(tmp_path / "any.sens", w.sens_bytes())
    assert len(scans.load(str(path)).scans) == 3


@pytest.mark.parametrize("colour_kind", [1, 2])
@pytest.mark.parametrize("depth_kind", [0, 1])
def test_sens_encodings(colour_kind: int, depth_kind: int, tmp_path: Path) -> None:
    header = w.SensHeader(colour_kind=colour_kind, depth_kind=depth_kind)
    path = w.put(tmp_path / "scene.sens", w.sens_bytes(header=header))

    frame = scans.load(path).scans[2].load()

    np.testing.assert_allclose(frame.depth, w.samples()[2].raw / 1000, rtol=1e-6)
    assert np.abs(frame.colour.astype(int) - w.samples()[2].colour).mean() < 2.0


def test_names_are_in_natural_order(tmp_path: Path) -> None:
    w.write_scannet(tmp_path, w.samples(12))
    assert [s.name for s in scans.load(tmp_path).scans] == [str(10 * i) for i in range(12)]


def test_camera_file_of_3dmatch(tmp_path: Path) -> None:
    w.write_seven_scenes(tmp_path)
    (tmp_path / "intrinsics.txt").rename(tmp_path / "camera-intrinsics.txt")
    assert scans.load(tmp_path).scans[0].intrinsics.fy == 62.0


def test_scans_without_poses_have_no_truth_and_inf_is_none(tmp_path: Path) -> None:
    w.write_scannet(tmp_path)
    (tmp_path / "pose" / "0.txt").unlink()
    w.put(tmp_path / "pose" / "10.txt", w.rows(np.full((4, 4), -np.inf)))
    assert list(scans.truth(tmp_path)) == ["20"]


def test_rotations_become_orthonormal(tmp_path: Path) -> None:
    w.write_seven_scenes(tmp_path)
    rough = w.samples()[1].world_T_scan.copy()
    rough[:3, :3] += 4e-4
    w.put(tmp_path / "frame-000001.pose.txt", w.rows(rough))

    rotation = scans.truth(tmp_path)["frame-000001"][:3, :3]

    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert se3.rotation_angle(rotation.T @ w.samples()[1].world_T_scan[:3, :3]) < 2e-3


@pytest.mark.parametrize("colour", ["color", "image", "rgb"])
def test_redwood_matches_by_order_when_no_name_is_common(colour: str, tmp_path: Path) -> None:
    w.write_redwood(tmp_path)
    for i, path in enumerate(sorted((tmp_path / "color").iterdir())):
        path.rename(path.with_name(f"{i + 1:07d}-{33 * i:012d}.jpg"))
    (tmp_path / "color").rename(tmp_path / colour)

    found = scans.load(tmp_path)

    assert [s.name for s in found.scans][1] == "0000002-000000000033"
    assert any("order" in note for note in found.notes)
    np.testing.assert_allclose(found.scans[1].load().depth, w.samples()[1].raw / 1000, rtol=1e-6)
    assert list(scans.truth(tmp_path)) == [s.name for s in found.scans]


def test_order_is_natural_where_names_have_no_leading_zeros(tmp_path: Path) -> None:
    made = w.samples(11)
    w.write_redwood(tmp_path, made)
    for i, path in enumerate(sorted((tmp_path / "color").iterdir())):
        path.rename(path.with_name(f"image{i}.jpg"))

    found = {scan.name: scan.load() for scan in scans.load(tmp_path).scans}

    for i, written in enumerate(made):
        np.testing.assert_allclose(found[f"image{i}"].depth, written.raw / 1000, rtol=1e-6)


def test_camera_json_may_be_by_rows_and_give_the_depth_scale(tmp_path: Path) -> None:
    w.write_redwood(tmp_path, w.samples(raw_per_metre=4000.0))
    content = w.camera_json() | {"intrinsic_matrix": w.CAMERA.ravel().tolist()}
    w.put(tmp_path / "camera_intrinsic.json", json.dumps(content | {"depth_scale": 4000.0}))

    found = scans.load(tmp_path)

    assert found.scans[0].intrinsics.cx == 31.5
    assert found.depth_unit_m == pytest.approx(1 / 4000)


def test_tum_pairs_nearest_in_time_and_leaves_the_rest_out(tmp_path: Path) -> None:
    w.write_tum(tmp_path)
    lists = (tmp_path / "rgb.txt").read_text() + "105.0 rgb/105.png\n100.005 rgb/100.005.png\n"
    w.put(tmp_path / "rgb.txt", lists)
    for name in ("105", "100.005"):
        w.put(tmp_path / f"rgb/{name}.png", w.encode(w.colour_ramp(w.WIDTH, w.HEIGHT)))

    found = scans.load(tmp_path)

    assert [s.name for s in found.scans] == ["100.005", "101.000000", "102.000000"]
    assert any("2 of 5" in note for note in found.notes)


def test_tum_lists_may_name_more_than_a_chosen_subset(tmp_path: Path) -> None:
    w.write_tum(tmp_path)
    (tmp_path / "rgb/101.000000.png").unlink()
    (tmp_path / "depth/101.010000.png").unlink()
    assert [s.name for s in scans.load(tmp_path).scans] == ["100.000000", "102.000000"]


def test_tum_poses_far_in_time_are_not_used(tmp_path: Path) -> None:
    w.write_tum(tmp_path)
    lines = (tmp_path / "groundtruth.txt").read_text().replace("\n101.0", "\n101.5")
    w.put(tmp_path / "groundtruth.txt", lines)
    assert list(scans.truth(tmp_path)) == ["100.000000", "102.000000"]


@pytest.mark.parametrize(
    ("raw_per_metre", "unit"), [(5000, 1 / 1000), (10000, 1 / 5000), (1000, 1 / 1000)]
)
def test_depth_unit_is_the_usual_one_unless_it_makes_no_sense(
    raw_per_metre: int, unit: float, tmp_path: Path
) -> None:
    w.write_seven_scenes(tmp_path, w.samples(raw_per_metre=raw_per_metre))
    found = scans.load(tmp_path)
    assert found.depth_unit_m == pytest.approx(unit)
    warned = any("unusual" in note or "would make" in note for note in found.notes)
    assert warned == (raw_per_metre != 1000)


def test_depth_unit_can_be_given(tmp_path: Path) -> None:
    w.write_seven_scenes(tmp_path, w.samples(raw_per_metre=5000))
    frame = scans.load(tmp_path, depth_unit_m=1 / 5000).scans[0].load()
    assert frame.depth.max() == pytest.approx(3.0)


def test_no_measurement_is_zero(tmp_path: Path) -> None:
    made = w.samples()
    made[0].raw[10:20] = 65535
    depth = scans.load(w.write_seven_scenes(tmp_path, made)).scans[0].load().depth
    assert (depth[10:20] == 0).all() and depth[20:, 10:].min() > 1.0


def test_inspection_tells_people_and_programs(tmp_path: Path) -> None:
    w.write_tum(tmp_path)

    found = scans.inspect(tmp_path)

    data = json.loads(json.dumps(found.as_dict(), allow_nan=False))
    assert (data["format"], data["poses"]) == ("tum", 3)
    assert data["depth_size"] == data["colour_size"] == [w.WIDTH, w.HEIGHT]
    assert data["intrinsics"]["fx"] == 60.0
    assert data["depth_unit_m"] == pytest.approx(1 / 5000)
    first = data["scans"][0]
    assert first["valid_share"] == pytest.approx(1 - 16 / (w.WIDTH * w.HEIGHT))
    np.testing.assert_allclose(first["depth_m"], [1.575, 2.25, 2.925], atol=0.02)
    for piece in ("tum", "0.0002", "101.000000", "64 x 48", "99.5%"):
        assert piece in found.text()


def test_inspection_warns(tmp_path: Path) -> None:
    made = w.samples()
    made[1].raw[:, 8:] = 0
    w.write_seven_scenes(tmp_path, made)
    w.put(tmp_path / "frame-000000.pose.txt", "not a pose")

    warnings = "\n".join(scans.inspect(tmp_path).warnings)

    assert "frame-000001" in warnings and "20%" in warnings
    assert "frame-000000.pose.txt" in warnings
    with pytest.raises(ScanError, match=r"frame-000000\.pose\.txt"):
        scans.truth(tmp_path)
