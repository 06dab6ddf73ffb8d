"""The whole way on a generated room: results, determinism, what is left on disk."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fewview
from fewview import evaluation, pipeline, synthetic
from fewview import scans as readers
from fewview.cli import ALL_PLACED, BAD_INPUT, INTERRUPTED, PARTIAL, main
from fewview.ply import read_ply
from fewview.report import save
from fewview.types import Alternative, AlternativePlace, Observer, Reconstruction

RESULTS = ("mesh.ply", "mesh.json", "mesh.tum.txt")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five scans of a generated room with ground truth beside them."""
    path = tmp_path_factory.mktemp("room") / "scans"
    scene = synthetic.generate(synthetic.split_seed("test", 1), 5, seed=2, mode="spread")
    synthetic.write(path, scene)
    return path


@pytest.fixture(scope="module")
def result(folder: Path) -> Reconstruction:
    return pipeline.reconstruct(fewview.load(folder), jobs=2)


def results_of(folder: Path) -> dict[str, bytes]:
    """The files of a run, the report without its clock."""
    found = {name: (folder / name).read_bytes() for name in RESULTS}
    report = json.loads(found["mesh.json"])
    del report["timings_s"]
    found["mesh.json"] = json.dumps(report).encode()
    return found


def run(scans: Path, out: Path, *options: str) -> int:
    out.mkdir(exist_ok=True)
    return main(["reconstruct", str(scans), "--out", str(out / "mesh.ply"), *options])


def test_placed_scans_are_right(folder: Path, result: Reconstruction, tmp_path: Path) -> None:
    report = json.loads(save(result, tmp_path / "mesh.ply").read_text())
    scores = evaluation.evaluate_report(report, readers.truth(folder))
    assert sum(s["placed"] for s in report["scans"]) >= 3
    for scan in scores["scans"]:
        if scan["placed"] and scan["probability"] > 0.9:
            assert scan["rotation_deg"] < 3.0 and scan["translation_m"] < 0.1


def test_report_follows_the_contract(result: Reconstruction, tmp_path: Path) -> None:
    path = save(result, tmp_path / "mesh.ply")
    report = json.loads(path.read_text(), parse_constant=lambda _: pytest.fail("not strict"))
    assert report["format"] == 1 and report["units"] == "m"
    assert report["fewview"] == fewview.__version__
    assert len(report["pairs"]) == 10
    for pair in report["pairs"]:
        ranks = [c["rank"] for c in pair["candidates"]]
        assert ranks == list(range(len(ranks)))
        assert pair["selected"] is None or pair["selected"] in ranks
        assert sum(c["probability"] for c in pair["candidates"]) < 1.0 + 1e-6
        for candidate in pair["candidates"]:
            pose = np.array(candidate["target_T_source"])
            np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-6)
            assert set(candidate["support"]) == {"panorama", "layout", "planes", "keypoints"}
    for component in report["components"]:
        registration = component["registration"]
        lower = registration["residual_after_m"] < registration["residual_before_m"]
        assert lower or not registration["accepted"]
    mesh = read_ply(tmp_path / "mesh.ply")
    assert report["mesh"]["vertices"] == len(mesh.vertices) > 1000
    lines = (tmp_path / "mesh.tum.txt").read_text().splitlines()
    first = [s for s in report["scans"] if s["component"] == 0]
    assert len(lines) == len(first) and all(len(line.split()) == 8 for line in lines)


def test_the_report_lists_what_else_the_scans_could_be(
    result: Reconstruction, tmp_path: Path
) -> None:
    name = result.scans.scans[1].name
    places = (AlternativePlace(1, 0, np.eye(4)), AlternativePlace(2, None, None))
    solution = replace(result.solution, alternatives=(Alternative(0.5, places),))
    path = save(replace(result, solution=solution), tmp_path / "mesh.ply")
    [told] = json.loads(path.read_text())["alternatives"]
    assert told["margin"] == 0.5
    assert told["odds"] == pytest.approx(np.exp(-0.5))
    assert told["differs"] == [name, result.scans.scans[2].name]
    first, second = told["scans"]
    assert first == {"name": name, "component": 0, "world_T_scan": np.eye(4).tolist()}
    assert (second["component"], second["world_T_scan"]) == (None, None)


def test_world_is_level_and_stands_on_the_floor(result: Reconstruction) -> None:
    component = result.solution.components[0]
    heights = [
        pose[2, 3]
        for i in component.scans
        if (pose := result.solution.placements[i].world_T_scan) is not None
    ]
    assert component.world == "floor"
    assert all(1.0 < h < 1.9 for h in heights)
    assert abs(np.percentile(result.meshes[0].vertices[:, 2], 1)) < 0.15


def test_candidates_are_different_answers(result: Reconstruction) -> None:
    from fewview.geometry import se3

    for pair in result.pairs:
        poses = [c.target_T_source for c in pair.candidates]
        for i in range(len(poses)):
            for j in range(i):
                turn, shift = se3.distance(poses[i], poses[j])
                assert np.degrees(turn) >= 15 or shift >= 0.3


def test_same_bytes_with_or_without_poses_recording_and_threads(
    folder: Path, tmp_path: Path
) -> None:
    bare = tmp_path / "bare"
    shutil.copytree(folder, bare)
    for pose in bare.glob("*.pose.txt"):
        pose.unlink()
    run(folder, tmp_path / "a", "--jobs", "2", "--no-rrd")
    run(bare, tmp_path / "b", "--jobs", "1")
    assert results_of(tmp_path / "a") == results_of(tmp_path / "b")
    assert (tmp_path / "b" / "mesh.rrd").stat().st_size > 10_000
    assert not (tmp_path / "a" / "mesh.rrd").exists()
    leftovers = [p.name for p in (tmp_path / "b").iterdir() if p.name.startswith(".")]
    assert leftovers == []


def test_observers_cannot_change_the_result(folder: Path, result: Reconstruction) -> None:
    class Vandal(Observer):
        def scan_completed(self, index: int, frame: object, completed: object) -> None:
            frame.colour[:] = 0  # type: ignore[attr-defined]

    again = pipeline.reconstruct(fewview.load(folder), jobs=1, observers=[Vandal()])
    for a, b in zip(result.solution.placements, again.solution.placements, strict=True):
        np.testing.assert_array_equal(a.world_T_scan, b.world_T_scan)


def test_ctrl_c_leaves_no_result(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("fewview.fusion.fuse", interrupt)
    assert run(folder, tmp_path / "out", "--no-store") == INTERRUPTED
    assert list((tmp_path / "out").iterdir()) == []


def test_unrelated_scans_are_not_forced_together(folder: Path, tmp_path: Path) -> None:
    mixed = tmp_path / "mixed"
    mixed.mkdir()
    other = synthetic.generate(synthetic.split_seed("test", 7), 1, seed=5, mode="random")
    synthetic.write(tmp_path / "other", other)
    for path in sorted(folder.glob("scan-000.*")) + [folder / "intrinsics.txt"]:
        shutil.copy(path, mixed / path.name)
    for path in (tmp_path / "other").glob("scan-000.*"):
        shutil.copy(path, mixed / path.name.replace("scan-000", "stranger"))
    assert run(mixed, tmp_path / "out", "--no-rrd") == PARTIAL
    report = json.loads((tmp_path / "out" / "mesh.json").read_text())
    assert all(s["world_T_scan"] is None and s["reason"] for s in report["scans"])


def test_pair_command_prints_json(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["pair", str(folder), "scan-000", "scan-001", "--json", "--top-k", "2"])
    pair = json.loads(capsys.readouterr().out)
    assert code in (ALL_PLACED, PARTIAL)
    assert (pair["source"], pair["target"]) == ("scan-000", "scan-001")
    assert len(pair["candidates"]) <= 2


def test_inspect_and_evaluate(
    folder: Path, result: Reconstruction, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["inspect", str(folder)]) == ALL_PLACED
    assert "640 x 480" in capsys.readouterr().out.replace("640x480", "640 x 480")
    save(result, tmp_path / "mesh.ply")
    assert main(["evaluate", str(folder), str(tmp_path / "mesh.json")]) == ALL_PLACED
    assert "deg" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["reconstruct", "nowhere", "--out", "mesh.ply"], "nowhere"),
        (["reconstruct", "SCANS", "--out", "no/such/mesh.ply"], "folder"),
        (["reconstruct", "SCANS", "--out", "mesh.obj"], ".ply"),
        (["reconstruct", "SCANS", "--out", "mesh.ply", "--preset", "hasty"], "preset"),
        (["reconstruct", "SCANS", "--out", "mesh.ply", "--set", "matching.topk=3"], "top_k"),
        (["reconstruct", "SCANS", "--out", "mesh.ply", "--config", "none.yaml"], "none.yaml"),
        (["reconstruct", "SCANS", "--out", "mesh.ply", "--store", "no/such"], "folder"),
        (["pair", "SCANS", "scan-000", "scan-999"], "scan-999"),
        (["pair", "SCANS", "scan-000", "scan-000"], "different"),
        (["evaluate", "SCANS", "none.json"], "none.json"),
        (["view", "none.rrd"], "none.rrd"),
    ],
)
def test_bad_arguments_give_one_line(
    arguments: list[str],
    word: str,
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([str(folder) if a == "SCANS" else a for a in arguments]) == BAD_INPUT
    error = capsys.readouterr().err.strip()
    assert error.count("\n") == 0 and word in error and "Traceback" not in error
    assert list(tmp_path.iterdir()) == []


def test_corrupt_pixels_end_the_run_without_output(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "broken"
    shutil.copytree(folder, broken)
    image = next(broken.glob("scan-002.color.*"))
    image.write_bytes(image.read_bytes()[:2000])
    assert run(broken, tmp_path / "out") == BAD_INPUT
    assert "scan-002" in capsys.readouterr().err.splitlines()[-1]
    assert list((tmp_path / "out").iterdir()) == []
