"""Data sets of the yardstick: scenes, rooms, pair lists and frame sets."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmark import datasets, pairs, sets
from benchmark.datasets import Dataset, open_dataset
from benchmark.rooms import rooms
from benchmark.scenes import Scene, rolled
from fewview import scans, synthetic
from fewview.evaluation.overlap import overlap
from fewview.geometry import se3
from fewview.scans.writer import write as write_scans
from fewview.types import Array, Frame
from tests.test_scans_matterport import write_house

SIZE = (160, 120)
VIEWS = 6


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def dataset(cache: Path) -> Dataset:
    made = rooms("validation", 2, VIEWS, cache, size=SIZE, jobs=1)
    return Dataset("rooms-validation", tuple(made), "rooms:validation")


@pytest.fixture
def scene(dataset: Dataset) -> Scene:
    return dataset.scenes[0]


def looking(yaw_deg: float, pitch_deg: float = 0.0) -> Array:
    """A camera of a world with y down, turned about its vertical, then tilted."""
    turn = se3.rotation_exp(np.array([0.0, np.radians(yaw_deg), 0.0]))
    tilt = se3.rotation_exp(np.array([np.radians(pitch_deg), 0.0, 0.0]))
    return se3.pose(turn @ tilt, np.zeros(3))


def posed(folder: Path, poses: list[Array], names: list[str] | None = None) -> Scene:
    """Frames of a flat wall, 40x30, with given poses."""
    names = names or [f"frame-{i:06d}" for i in range(len(poses))]
    grey, wall = np.full((30, 40, 3), 99, np.uint8), np.full((30, 40), 2.0, np.float32)
    flat = Frame(grey, wall, synthetic.kinect(40, 30))
    truth = dict(zip(names, poses, strict=True))
    write_scans(folder, [(name, flat) for name in names], truth)
    return Scene(folder)


def test_a_room_is_what_the_generator_made(scene: Scene) -> None:
    made = synthetic.generate(
        synthetic.split_seed("validation", 0), VIEWS, 0, synthetic.ViewMode.RANDOM, *SIZE
    )
    assert scene.names == made.names
    for name, frame in zip(scene.names, made.frames, strict=True):
        np.testing.assert_allclose(scene.truth[name], made.poses[name], atol=1e-6)
        np.testing.assert_allclose(scene.load(name).depth, frame.depth, atol=6e-4)
        assert len(scene.cloud(name)) == np.count_nonzero(frame.depth)
    mesh = scene.mesh()
    assert mesh is not None
    np.testing.assert_allclose(mesh.vertices, made.mesh.vertices, atol=1e-5)
    np.testing.assert_array_equal(mesh.colours, made.mesh.colours)


def test_rooms_are_made_once_and_in_part(dataset: Dataset, cache: Path) -> None:
    before = (dataset.scenes[1].folder / "truth.ply").stat().st_mtime_ns
    again = rooms("validation", 2, VIEWS, cache, size=SIZE, jobs=1)
    assert again == list(dataset.scenes)
    assert (again[1].folder / "truth.ply").stat().st_mtime_ns == before
    assert [p.name for p in again[0].folder.parent.iterdir() if p.name[0] == "."] == []


def test_scenes_travel_between_processes(scene: Scene) -> None:
    copy = pickle.loads(pickle.dumps(scene))
    np.testing.assert_array_equal(copy.load(scene.names[2]).depth, scene.load(scene.names[2]).depth)


def test_only_frames_with_truth_count_in_the_order_of_the_recording(tmp_path: Path) -> None:
    scene = posed(tmp_path, [looking(10.0 * i) for i in range(3)], ["2", "10", "30"])
    assert scene.names == ("2", "10", "30")
    (tmp_path / "10.pose.txt").unlink()
    assert Scene(tmp_path).names == ("2", "30")
    assert Scene(tmp_path, ("30",)).names == ("30",)


def test_the_fingerprint_follows_files_and_frames(tmp_path: Path) -> None:
    scene = posed(tmp_path, [looking(0.0), looking(5.0), looking(9.0)])
    assert Scene(tmp_path).fingerprint == scene.fingerprint
    assert Scene(tmp_path, scene.names[:2]).fingerprint != scene.fingerprint
    (tmp_path / "frame-000002.pose.txt").unlink()
    assert Scene(tmp_path).fingerprint != scene.fingerprint


def test_up_and_yaw(tmp_path: Path) -> None:
    scene = posed(
        tmp_path, [looking(0.0), looking(70.0), looking(-170.0, -30.0), looking(0.0, -20)]
    )
    names = scene.names
    assert scene.up @ [0.0, -1.0, 0.0] > np.cos(np.radians(10.0))
    scene.__dict__["up"] = np.array([0.0, -1.0, 0.0])
    assert scene.yaw_deg(names[0], names[1]) == pytest.approx(70.0)
    assert scene.yaw_deg(names[0], names[2]) == pytest.approx(170.0)
    assert scene.yaw_deg(names[1], names[2]) == pytest.approx(120.0)
    assert scene.yaw_deg(names[3], names[0]) == pytest.approx(0.0, abs=1e-5)


def test_overlaps_follow_the_protocol_and_are_kept(scene: Scene, cache: Path) -> None:
    matrix = scene.overlaps(cache)
    assert matrix.shape == (VIEWS, VIEWS)
    a, b = np.unravel_index(np.argmax(matrix - np.eye(VIEWS)), matrix.shape)
    source, target = scene.names[int(a)], scene.names[int(b)]
    target_T_source = se3.inverse(scene.truth[target]) @ scene.truth[source]
    exact = overlap(scene.cloud(source), scene.cloud(target), target_T_source)
    assert exact > 0.05 and matrix[a, b] == pytest.approx(exact, abs=0.03)

    kept = next(cache.glob(f"overlaps/{scene.name}-{scene.fingerprint}.npy"))
    np.save(kept, 2.0 * matrix)
    np.testing.assert_array_equal(Scene(scene.folder).overlaps(cache), 2.0 * matrix)
    np.save(kept, matrix)


def test_half_of_a_rolled_scene_is_turned_and_its_points_stay(scene: Scene, cache: Path) -> None:
    copy = rolled(scene, 0, cache)

    assert copy.name == scene.name and copy.fingerprint != scene.fingerprint
    moved = [n for n in scene.names if not np.allclose(copy.truth[n], scene.truth[n], atol=1e-6)]
    assert len(moved) == VIEWS // 2
    for name in scene.names:
        here = se3.transform(scene.truth[name], scene.cloud(name))
        there = se3.transform(copy.truth[name], copy.cloud(name))
        np.testing.assert_allclose(np.sort(here, axis=0), np.sort(there, axis=0), atol=1e-5)
    assert copy.up @ scene.up > np.cos(np.radians(15.0))
    assert copy.mesh() is not None
    assert rolled(scene, 0, cache).fingerprint == copy.fingerprint
    assert rolled(scene, 1, cache).folder != copy.folder


def test_written_frames_have_no_poses_and_the_same_pixels(scene: Scene, tmp_path: Path) -> None:
    scene.write(scene.names[1:4], tmp_path / "scans")
    assert scans.truth(tmp_path / "scans") == {}
    for scan in scans.load(tmp_path / "scans").scans:
        written, frame = scan.load(), scene.load(scan.name)
        np.testing.assert_array_equal(written.colour, frame.colour)
        np.testing.assert_array_equal(written.depth, frame.depth)
        assert written.intrinsics == frame.intrinsics


def test_a_folder_of_scenes_gives_25_views_of_each(tmp_path: Path) -> None:
    for name in ("scene0000_00", "scene0001_00"):
        posed(tmp_path / name, [looking(3.0 * i) for i in range(30)])
    (tmp_path / "notes").mkdir()

    found = open_dataset(str(tmp_path), quick=False, cache=tmp_path)

    assert [scene.name for scene in found.scenes] == ["scene0000_00", "scene0001_00"]
    first, second = (scene.names for scene in found.scenes)
    assert len(first) == len(second) == 25 and first != second
    assert found == open_dataset(str(tmp_path), quick=True, cache=tmp_path)
    assert found.scenes[0].load(first[-1]).depth.shape == (30, 40)
    alone = open_dataset(str(tmp_path / "scene0000_00"), quick=False, cache=tmp_path)
    assert alone.name == "scene0000_00" and len(alone.scenes[0].names) == 30


def test_views_of_a_house_are_of_one_room(tmp_path: Path) -> None:
    rows = [se3.pose(np.eye(3), np.array([20.0 * (i % 2), 0.01 * i, 0.0])) for i in range(56)]
    write_house(tmp_path / "houses" / "17DRP", rows)
    (scene,) = open_dataset(str(tmp_path / "houses"), quick=False, cache=tmp_path).scenes
    eyes = np.stack([scene.truth[name][:3, 3] for name in scene.names])
    assert len(eyes) == 25 and np.ptp(eyes[:, 0]) == 0.0


def test_quick_takes_few_scenes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in "abc":
        posed(tmp_path / name, [looking(0.0), looking(5.0)])
    monkeypatch.setattr(datasets, "QUICK_SCENES", 2)
    found = open_dataset(str(tmp_path), quick=True, cache=tmp_path)
    assert [scene.name for scene in found.scenes] == ["a", "b"]


def test_data_sets_that_cannot_be(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=r"rooms:trian is no data set: give rooms"):
        open_dataset("rooms:trian", quick=True, cache=tmp_path)
    with pytest.raises(SystemExit, match="holds no scans of a known layout"):
        open_dataset(str(tmp_path), quick=True, cache=tmp_path)
    posed(tmp_path / "a", [looking(0.0), looking(5.0)])
    (tmp_path / "a" / "frame-000000.pose.txt").unlink()
    with pytest.raises(SystemExit, match="fewer than 2 frames with a true pose"):
        open_dataset(str(tmp_path / "a"), quick=True, cache=tmp_path)


def test_pairs_are_spread_without_repetition(dataset: Dataset, cache: Path) -> None:
    drawn = pairs.draw(dataset, 21, 3, cache).pairs

    assert [sum(p.scene == s.name for p in drawn) for s in dataset.scenes] == [11, 10]
    unordered = {(p.scene, *sorted((p.source, p.target))) for p in drawn}
    assert len(unordered) == 21
    assert 0 < sum(p.source < p.target for p in drawn) < 21, "the order within a pair is random"
    for pair in drawn[:4]:
        scene = dataset.scenes[0]
        a, b = scene.names.index(pair.source), scene.names.index(pair.target)
        assert pair.overlap == scene.overlaps(cache)[a, b]
        assert pair.yaw_deg == scene.yaw_deg(pair.source, pair.target)
    assert pairs.draw(dataset, 21, 3, cache).pairs == drawn
    assert pairs.draw(dataset, 21, 4, cache).pairs != drawn
    assert len(pairs.draw(dataset, 1000, 3, cache).pairs) == 2 * VIEWS * (VIEWS - 1) // 2


def test_a_list_is_kept_in_its_file(dataset: Dataset, cache: Path, tmp_path: Path) -> None:
    path = tmp_path / "lists" / "pairs.json"
    drawn = pairs.load_or_draw(path, dataset, 8, 0, cache)
    content = path.read_bytes()
    assert drawn == pairs.draw(dataset, 8, 0, cache)
    assert pairs.load_or_draw(path, dataset, 8, 0, cache) == drawn
    assert path.read_bytes() == content
    stored = json.loads(content)
    assert (stored["seed"], stored["count"], stored["dataset"]) == (0, 8, "rooms-validation")


def test_a_list_of_other_data_is_refused(dataset: Dataset, cache: Path, tmp_path: Path) -> None:
    path = tmp_path / "pairs.json"
    pairs.load_or_draw(path, dataset, 8, 0, cache)
    with pytest.raises(SystemExit, match="8 pairs of rooms-validation drawn with seed 0, not 9"):
        pairs.load_or_draw(path, dataset, 9, 0, cache)
    fewer = replace(dataset, scenes=dataset.scenes[:1])
    with pytest.raises(SystemExit, match="drawn from other data.*validation-001"):
        pairs.load_or_draw(path, fewer, 8, 0, cache)
    path.write_text("[]")
    with pytest.raises(SystemExit, match="is not a list of pairs"):
        pairs.load_or_draw(path, dataset, 8, 0, cache)


def test_difficulty() -> None:
    made = [
        pairs.Pair("s", "a", "b", overlap, yaw, (0.0, 0.0, 1.0))
        for overlap, yaw in ((0.0, 180.0), (0.05, 150.0), (0.7, 29.9), (1.0, 30.0))
    ]
    found = pairs.difficulty(made)
    assert found["pairs"] == 4
    assert found["overlap"] == {
        "< 1 %": 0.25,
        "1-10 %": 0.25,
        "10-30 %": 0.0,
        "30-50 %": 0.0,
        ">= 50 %": 0.5,
    }
    yaws = found["yaw_deg"]
    assert isinstance(yaws, dict)
    assert list(yaws.values()) == [0.25, 0.25, 0.0, 0.0, 0.0, 0.5]


def drawn_sets(scene: Scene, kind: str, cache: Path, seed: int = 0) -> list[sets.FrameSet]:
    return sets.frame_sets(scene, kind, counts={5: 2, 6: 1, 7: 1}, limit=3, seed=seed, cache=cache)


def test_random_sets(scene: Scene, cache: Path) -> None:
    found = drawn_sets(scene, "random", cache)
    assert [one.id for one in found] == ["random-05-0", "random-05-1", "random-06-0"]
    assert all(len(set(one.names)) == len(one.names) for one in found)
    assert found == drawn_sets(scene, "random", cache)
    assert found[:2] != drawn_sets(scene, "random", cache, seed=1)[:2]


@pytest.mark.parametrize("kind", ["low", "extreme"])
def test_sets_of_little_overlap(kind: str, tmp_path: Path) -> None:
    scene = posed(tmp_path, [looking(9.0 * i) for i in range(8)])
    bound = sets.BOUNDS[kind]
    matrix = np.full((8, 8), bound + 0.01)
    matrix[:6, :6] = bound
    path = tmp_path / "overlaps" / f"{scene.name}-{scene.fingerprint}.npy"
    path.parent.mkdir()
    np.save(path, matrix)

    found = drawn_sets(scene, kind, tmp_path)

    assert len(found) == 3 and len({one.names for one in found}) == 3
    assert all(set(one.names) <= set(scene.names[:6]) for one in found)
    np.save(path, np.ones((8, 8)))
    assert drawn_sets(scene, kind, tmp_path) == []


def test_listed_sets_come_first(tmp_path: Path, cache: Path) -> None:
    scene = posed(tmp_path, [looking(9.0 * i) for i in range(8)])
    (tmp_path / "sets-extreme.txt").write_text("0 3 5 6 7\n5 4 1 2 0\n")
    (tmp_path / "sets-random.txt").write_text("0 2 3 5 6\n")
    extreme = drawn_sets(scene, "extreme", cache)
    assert [one.id for one in extreme] == ["extreme-05-0", "extreme-05-1"]
    assert extreme[1].names == tuple(f"frame-{i:06d}" for i in (0, 1, 2, 4, 5))
    ids = [one.id for one in drawn_sets(scene, "random", cache)]
    assert ids == ["random-05-0", "random-06-0", "random-07-0"]


def test_wide_sets_are_those_picked_by_hand(scene: Scene, tmp_path: Path, cache: Path) -> None:
    names = [f"frame-{i:06d}" for i in (*sets.WIDE["studyroom"], 5000)]
    study = posed(tmp_path / "studyroom", [looking(0.0)] * len(names), names)
    assert [one.names for one in drawn_sets(study, "wide", cache)] == [tuple(names[:-1])]
    assert drawn_sets(scene, "wide", cache) == []
    with pytest.raises(SystemExit, match="no 'narrow' sets: take random"):
        drawn_sets(scene, "narrow", cache)


def test_overlaps_of_a_set(scene: Scene, cache: Path) -> None:
    a, b, c = scene.names[0], scene.names[2], scene.names[5]
    matrix = scene.overlaps(cache)
    expected = {(a, b): matrix[0, 2], (a, c): matrix[0, 5], (b, c): matrix[2, 5]}
    assert sets.overlaps_by_name(scene, (a, b, c), cache) == expected


def test_every_data_set_has_sets_of_all_sizes(dataset: Dataset) -> None:
    alone = replace(dataset, scenes=dataset.scenes[:1])
    for one, quick in ((alone, True), (alone, False), (dataset, True), (dataset, False)):
        assert list(sets.random_counts(one, quick)) == [5, 10, 15, 20]
    assert set(sets.random_counts(dataset, False).values()) == {1}
