"""The yardstick of completion: perfect and known answers, baselines, and what a rerun gives."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

import table_completion
from benchmark import completion_speed, completion_views
from benchmark.completion_baselines import (
    DIRECTIONS,
    KINDS,
    RingAnswer,
    Typical,
    box_around,
    box_ground,
    box_ring,
    seen_patches,
)
from benchmark.completion_measure import BOX, COMPLETED, TYPICAL, measured
from benchmark.completion_networks import MAKERS, Networks
from benchmark.completion_recall import CHANCE, PAIRS, RECALL_1, RECALL_5, wall_recall
from benchmark.completion_scores import (
    Counts,
    ground_counts,
    ground_figures,
    ground_parts,
    plane_counts,
    plane_figures,
    ring_counts,
    ring_figures,
    ring_parts,
    seen_cells,
    total,
)
from benchmark.completion_speed import CPU, TOGETHER, SpeedTask
from benchmark.completion_tables import GROUNDS, PLANES, RECALLS, RINGS, summarise, tables
from benchmark.completion_views import SIZE, GeneratedRoom, View
from benchmark.run import Task
from benchmark.store import Record, Store
from fewview import weights
from fewview.completion.layout.grid import DOOR, FREE, WALL
from fewview.synthetic.samples import RoomSample
from fewview.training.point_batches import FLOOR
from fewview.training.point_batches import WALL as WALL_PLANE
from fewview.types import Array, CompletedPlanes, Frame, Intrinsics, StructuralPlane
from tests.box_rooms import box_room

SIZES = {
    "panorama": {"width": 16, "descriptor": 8},
    "layout": {"width": 8, "point_features": 4},
    "structure": {"local": 8, "whole": 16, "sector": 8},
}
REACH = np.array([2.0, 2.0, 2.0, 2.0, 1.4, 1.1])


@pytest.fixture(autouse=True)
def box_rooms(monkeypatch: pytest.MonkeyPatch) -> None:
    def made(split: str, index: int, views: int, size: int, library: None) -> RoomSample:
        return box_room(index + 1000 * (split == "train"), views, size)

    monkeypatch.setattr(completion_views, "generated", made)


@pytest.fixture
def view() -> View:
    return GeneratedRoom("test", 4, 1).views()[0]


@pytest.fixture(scope="module")
def networks(tmp_path_factory: pytest.TempPathFactory) -> Networks:
    folder = tmp_path_factory.mktemp("weights")
    torch.manual_seed(0)
    for name, size in SIZES.items():
        card = {"config": {"settings": {"size": size}}, "steps": 0}
        weights.save(name, folder, MAKERS[name](size).state_dict(), card)
    return Networks.found([folder])


def perfect(view: View) -> RingAnswer:
    truth = view.truth
    sure = np.full(truth.depth.shape, 0.95, np.float32)
    return RingAnswer(truth.depth, truth.normals, truth.semantics, sure)


def typical_of(view: View) -> Typical:
    return Typical(perfect(view), REACH, view.truth.ground[None])


def test_a_perfect_ring_has_no_error(view: View) -> None:
    for where in ring_parts(view).values():
        if not where.any():
            continue
        found = ring_figures(ring_counts(perfect(view), view.truth, where))
        assert found["depth_l1_m"] == found["depth_relative"] == 0.0
        assert found["depth_within_10_per_cent"] == 1.0
        assert found["normal_within_30"] == found["semantics_iou"] == 1.0
        assert found["normal_mean_deg"] < 0.5
        assert found["calibration"]["ece"] == pytest.approx(0.05, abs=1e-5)


def test_a_ring_that_is_off_says_by_how_much(view: View) -> None:
    truth, answer = view.truth, perfect(view)
    turned = np.roll(answer.normals, 1, axis=-1)
    off = replace(answer, depth=1.2 * truth.depth, normals=turned)
    found = ring_figures(ring_counts(off, truth, ring_parts(view)["unobserved"]))
    assert found["depth_relative"] == pytest.approx(0.2, abs=1e-5)
    assert found["depth_l1_m"] == pytest.approx(
        0.2 * truth.depth[ring_parts(view)["unobserved"]].mean(), rel=1e-4
    )
    assert found["depth_within_10_per_cent"] == 0.0
    assert found["normal_median_deg"] == pytest.approx(90.0, abs=1.0)
    assert found["calibration"]["ece"] == pytest.approx(0.95, abs=1e-5)


def test_a_class_that_is_never_told_counts_as_any_other(view: View) -> None:
    answer = perfect(view)
    wall = replace(answer, semantics=np.ones_like(answer.semantics))
    where = ring_parts(view)["unobserved"]
    found = ring_figures(ring_counts(wall, view.truth, where))
    classes = np.unique(view.truth.semantics[where])
    share = (view.truth.semantics[where] == 1).mean()
    assert found["semantics_iou"] == pytest.approx(share / len(classes))
    assert found["iou"]["floor"] == 0.0 and found["iou"]["bed"] is None


def test_counts_of_parts_add_up(view: View) -> None:
    where = ring_parts(view)["unobserved"]
    half = where & (np.arange(4 * SIZE) < SIZE)
    answer = replace(perfect(view), depth=view.truth.depth + 0.1)
    both = total(ring_counts(answer, view.truth, part) for part in (half, where & ~half))
    whole = ring_figures(ring_counts(answer, view.truth, where))
    again = ring_figures(both)
    assert again["pixels"] == whole["pixels"] == where.sum()
    assert again["depth_relative"] == pytest.approx(whole["depth_relative"])
    assert again["iou"] == whole["iou"]


def test_parts_of_a_ring_share_no_pixel(view: View) -> None:
    parts = ring_parts(view)
    assert sum(part.astype(int) for part in parts.values()).max() == 1
    assert parts["observed"].sum() == ((view.ring.depth > 0) & (view.truth.depth > 0)).sum()
    assert parts["unobserved"].mean() > 0.5


def test_figures_of_layouts(view: View) -> None:
    truth, parts = view.truth, ground_parts(view, seen_cells(view))
    assert 0.05 < parts["unobserved"].mean() < 0.95
    exact = ground_figures(ground_counts(truth.ground, truth, parts["unobserved"]))
    assert exact["accuracy"] == exact["mean_iou"] == 1.0
    nothing = ground_figures(ground_counts(0 * truth.ground, truth, parts["unobserved inside"]))
    assert nothing["accuracy"] == 0.0 == nothing["iou"]["wall"]


def test_doors_are_walls_where_the_truth_knows_none(view: View) -> None:
    doors = np.where(view.truth.ground == WALL, np.uint8(DOOR), view.truth.ground)
    where = view.truth.ground_known & (view.truth.ground != DOOR)
    blind = replace(view.truth, doors_known=False)
    assert ground_figures(ground_counts(doors, blind, where))["iou"]["wall"] == 1.0
    assert ground_figures(ground_counts(doors, view.truth, where))["iou"]["wall"] == 0.0


def test_seen_cells_are_those_ahead(view: View) -> None:
    seen = seen_cells(view)
    where = view.truth.ground[seen & view.truth.ground_known]
    assert (where == FREE).mean() > 0.4
    assert not seen[np.ix_([-1, -2], range(64))].any()


def test_true_planes_are_right_and_moved_ones_are_not(view: View) -> None:
    planes, kinds = view.truth.planes, view.truth.kinds
    exact = plane_figures(plane_counts(planes, kinds, view))["10 deg / 0.2 m"]
    assert exact["walls"]["all"] == {"precision": 1.0, "recall": 1.0, "told": 4, "true": 4}
    assert exact["walls"]["seen"]["true"] + exact["walls"]["unseen"]["true"] == 4
    assert 0 < exact["walls"]["seen"]["true"] < 4
    moved = planes + np.array([0.0, 0.0, 0.0, 0.25])
    strict, loose = plane_figures(plane_counts(moved, kinds, view)).values()
    assert strict["walls"]["all"]["recall"] == 0.0
    assert loose["walls"]["all"]["recall"] == 1.0
    swapped = plane_figures(plane_counts(planes, np.full_like(kinds, FLOOR), view))
    assert swapped["10 deg / 0.2 m"]["walls"]["all"]["recall"] == 0.0


def test_the_true_box_has_the_true_ring(view: View) -> None:
    order = (view.truth.planes[:, :3] @ -DIRECTIONS.T).argmax(axis=0)
    box = view.truth.planes[order]
    found = ring_figures(ring_counts(box_ring(box), view.truth, view.truth.semantics == 1))
    assert found["depth_relative"] < 0.02 and found["normal_within_30"] > 0.98
    assert found["semantics_accuracy"] > 0.98
    ground = ground_figures(
        ground_counts(box_ground(box, view), view.truth, view.truth.ground == 1)
    )
    assert ground["accuracy"] > 0.8


def test_a_box_goes_through_what_was_seen(view: View) -> None:
    box = box_around(view, REACH)
    found = plane_figures(plane_counts(box, KINDS, view))["10 deg / 0.2 m"]
    assert found["walls"]["seen"]["recall"] == 1.0
    far = box_around(view, REACH + 10.0)
    unseen = ~np.isclose(box[:, 3], far[:, 3])
    assert 0 < unseen.sum() < 6
    np.testing.assert_allclose(far[unseen, 3], -(REACH + 10.0)[unseen])


def test_patches_show_only_what_was_seen(view: View) -> None:
    found = plane_figures(plane_counts(*seen_patches(view), view))["10 deg / 0.2 m"]
    assert found["walls"]["seen"]["recall"] == 1.0
    assert found["walls"]["unseen"]["recall"] == 0.0


def test_the_nearest_layout_is_chosen_by_seen_cells(view: View) -> None:
    seen = seen_cells(view)
    own, other = view.truth.ground, np.roll(view.truth.ground, 9, axis=0)
    usual = Typical(perfect(view), REACH, np.stack([other, own, other]))
    np.testing.assert_array_equal(usual.nearest(own, seen), own)
    np.testing.assert_array_equal(usual.ground, other)


def under(counts: Counts, *start: str) -> Counts:
    return {k[len(start) :]: v for k, v in counts.items() if k[: len(start)] == start}


def test_all_that_is_measured_is_told(networks: Networks) -> None:
    views = GeneratedRoom("test", 4, 2).views()
    usual = typical_of(views[0])
    counts = measured(views, networks, usual, np.random.default_rng(0))
    again = measured(views, networks, usual, np.random.default_rng(0))
    assert all(np.array_equal(counts[key], again[key]) for key in counts)
    seen = ring_figures(under(counts, "ring", COMPLETED, "observed"))
    assert seen["depth_relative"] < 1e-4
    box = ring_figures(under(counts, "ring", BOX, "unobserved"))
    assert box["depth_relative"] < 0.6
    summary = summarise(counts)
    assert {RINGS, GROUNDS} <= set(summary[RECALLS]) <= {RINGS, GROUNDS, PLANES}
    assert set(summary[RECALLS][RINGS]) <= set(PAIRS)
    json.dumps(summary, allow_nan=False)
    text = "\n".join(table.markdown() for table in tables({"rooms": summary}, {}))
    assert all(title in text for title in ("360-image", "2D layout", "Structural planes"))


def told_walls(view: View, names: Array) -> CompletedPlanes:
    """The true walls, each with one of the rows of (4, D) ``names`` as its descriptor."""
    walls = view.truth.planes[view.truth.kinds == WALL_PLANE]
    planes = tuple(
        StructuralPlane("wall", w[3] * w[:3], w[:3], name, 1.0, True)
        for w, name in zip(walls, names.astype(np.float32), strict=True)
    )
    nothing = np.zeros((0, 3), np.float32)
    empty = np.zeros((0, names.shape[1]), np.float32)
    return CompletedPlanes(planes, nothing, nothing, empty, empty, empty[:, 0])


def test_walls_are_found_by_their_descriptors() -> None:
    views = GeneratedRoom("test", 4, 2).views()
    names = np.eye(4)
    same = wall_recall(views, [told_walls(view, names) for view in views])
    for pair in {pair for pair, _ in same}:
        assert same[pair, RECALL_1] == 1.0 and same[pair, CHANCE] == 0.25
    swapped = [told_walls(views[0], names), told_walls(views[1], np.roll(names, 1, axis=0))]
    wrong = wall_recall(views, swapped)
    assert {v for (_, figure), v in wrong.items() if figure == RECALL_1} == {0.0}
    assert {v for (_, figure), v in wrong.items() if figure == RECALL_5} == {1.0}


def test_networks_that_are_not_there_are_left_out(networks: Networks, tmp_path: Path) -> None:
    alone = Networks(tuple(f for f in networks.folders if f[0] == "structure"))
    views = GeneratedRoom("test", 4, 1).views()
    counts = measured(views, alone, typical_of(views[0]), np.random.default_rng(0))
    assert {key[0] for key in counts} <= {"planes", "recall"}
    titles = [table.title for table in tables({"rooms": summarise(counts)}, {})]
    assert titles == ["Structural planes", "Speed"]
    assert alone.key != networks.key
    with pytest.raises(SystemExit, match="no weights"):
        Networks.found([tmp_path])


def test_speed_is_measured_for_every_step(
    networks: Networks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    depth = np.full((48, 64), 2.0, np.float32)
    flat = Frame(np.zeros((48, 64, 3), np.uint8), depth, Intrinsics(64, 48, 60, 60, 31.5, 23.5))
    monkeypatch.setattr(
        completion_speed, "generate", lambda seed, scans: SimpleNamespace(frames=(flat,))
    )
    monkeypatch.setattr(completion_speed, "REPEATS", 1)
    monkeypatch.setattr(completion_speed, "THREADS", (1,))
    threads = torch.get_num_threads()
    found = SpeedTask(Store(tmp_path), networks).run().answer
    assert found is not None and torch.get_num_threads() == threads
    assert set(found) == {"ring and points", *SIZES, TOGETHER}
    assert all(set(ms) == {CPU, "1 thread"} and min(ms.values()) > 0 for ms in found.values())


def test_the_script_writes_the_same_files_again(
    networks: Networks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def here(tasks: list[Task], jobs: int, what: str) -> None:
        for task in tasks:
            if not task.path.is_file():
                task.store.write(task.path, task.run())

    told = Record({TOGETHER: {"1 thread": 9.0, "2 threads": 5.0}}, {})
    monkeypatch.setattr(SpeedTask, "run", lambda self: told)
    monkeypatch.setattr(table_completion, "run", here)
    monkeypatch.setattr(table_completion, "ROOMS", (2, 2))
    monkeypatch.setattr(table_completion, "TYPICAL_ROOMS", (2, 2))
    monkeypatch.setattr(table_completion, "VIEWS", (2, 2))
    out, folder = tmp_path / "out" / "completion.json", str(networks.folders[0][1])
    given = ["--cache", str(tmp_path / "cache"), "--networks", folder, "--out", str(out)]
    monkeypatch.setattr("sys.argv", ["table_completion.py", *given])
    files = [out.with_suffix(end) for end in (".json", ".md", ".tex")]
    written = []
    for _ in range(2):
        table_completion.main()
        written.append([file.read_bytes() for file in files])
    assert written[0] == written[1]
    results = json.loads(out.read_text())
    assert set(results["networks"]) == set(SIZES)
    figures = results["figures"]["rooms-test"]
    assert set(figures) == {RINGS, GROUNDS, PLANES, RECALLS}
    assert TYPICAL in figures[RINGS]
    assert results["speed_ms"][TOGETHER] == {"1 thread": 9.0, "2 threads": 5.0}
