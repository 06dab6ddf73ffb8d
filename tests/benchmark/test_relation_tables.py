"""Relation results: groups, floors, and what a rerun gives."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import table_relations
from benchmark.relation_runs import CEILING, PERTURBATIONS, RelationTask
from benchmark.relation_tables import (
    MAJORITY,
    PAPER_ACCURACY,
    PAPER_CONFUSION,
    reference,
    summarise,
    tables,
)
from benchmark.relations import PREDICTORS
from benchmark.rooms import rooms
from benchmark.scenes import Scene
from benchmark.store import Record, Store
from fewview.evaluation.relations import Relation

NAMES = [*PREDICTORS, CEILING]
COUNTS = np.array([[6, 2, 0, 0], [1, 3, 0, 0], [0, 0, 0, 0], [0, 0, 5, 15]])


def row(overlap: float, yaw_deg: float, perturbation_deg: float) -> dict[str, Any]:
    counts = dict.fromkeys(NAMES, COUNTS)
    return {
        "overlap": overlap,
        "yaw_deg": yaw_deg,
        "perturbation_deg": perturbation_deg,
        "counts": counts,
    }


def summary(from_mesh: bool = True) -> dict[str, Any]:
    found = [row(0.5, 20.0, 3.0), row(0.5, 20.0, 25.0), row(0.02, 170.0, 9.9)]
    return summarise(found, from_mesh)


def test_groups_split_by_overlap_perturbation_and_yaw() -> None:
    poses = {name: group["poses"] for name, group in summary().items()}
    assert poses == {
        "all": 3,
        "overlap >= 10 %": 2,
        "overlap < 10 %": 1,
        "perturbed by 0-10 deg": 2,
        "perturbed by 20-30 deg": 1,
        "true yaw 0-45 deg": 2,
        "true yaw 135-180 deg": 1,
    }


def test_counts_of_a_group_are_pooled() -> None:
    found = summary()["all"]
    scores = found["predictors"]["planar patches"]
    assert scores["counts"] == (3 * COUNTS).tolist()
    assert scores["accuracy"] == {
        "none": 0.75,
        "co-planar": 0.75,
        "parallel": None,
        "perpendicular": 0.75,
    }
    assert scores["mean"] == 0.75
    assert found["shares"]["perpendicular"] == pytest.approx(20 / 32)
    json.dumps(summary(), allow_nan=False)


def test_the_majority_is_that_of_the_labels() -> None:
    scores = summary()["all"]["predictors"][MAJORITY]
    assert list(scores["accuracy"].values()) == [0.0, 0.0, None, 1.0]


def test_measured_labels_have_no_ceiling() -> None:
    assert CEILING in summary()["all"]["predictors"]
    assert CEILING not in summary(from_mesh=False)["all"]["predictors"]


def test_the_papers_numbers_stand_once_beside_ours() -> None:
    accuracy, confusion = tables(summary(), "here")
    assert sum(row[0].startswith("the paper") for row in accuracy.rows) == 1
    assert confusion.rows[-1] == ["perpendicular", "0.568", "0.064", "0.054", "0.314"]
    sums = np.array(PAPER_CONFUSION).sum(axis=1)
    np.testing.assert_allclose(sums[1:], 1.0)
    assert sums[Relation.NONE] == pytest.approx(1.748)
    named = reference()["accuracy"]
    assert (named["none"], named["co-planar"]) == (PAPER_ACCURACY[0], 0.93)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return rooms("validation", 1, 2, tmp_path_factory.mktemp("rooms"), size=(320, 240), jobs=1)[0]


def test_a_task_gives_the_same_twice_and_depends_on_its_seed(scene: Scene, tmp_path: Path) -> None:
    source, target = scene.names
    tasks = [RelationTask(Store(tmp_path), scene, source, target, seed) for seed in (0, 0, 1)]
    first, again, other = (task.run().answer for task in tasks)
    assert first is not None and again is not None and other is not None
    assert len(first) == PERTURBATIONS
    assert len({one.perturbation_deg for one in first}) == PERTURBATIONS
    for one, two in zip(first, again, strict=True):
        assert one.perturbation_deg == two.perturbation_deg
        for name in NAMES:
            np.testing.assert_array_equal(one.counts[name], two.counts[name])
    assert other[0].perturbation_deg != first[0].perturbation_deg
    assert tasks[0].path == tasks[1].path != tasks[2].path


def test_a_failure_is_told_and_not_counted(scene: Scene, tmp_path: Path) -> None:
    source, target = scene.names
    task = RelationTask(Store(tmp_path), scene, source, target, 0)
    task.store.write(task.path, Record(None, {}, "ValueError: no idea"))
    with pytest.raises(SystemExit, match="no idea"):
        task.judged()


def test_the_script_writes_the_same_files_again(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def here(tasks: list[RelationTask], jobs: int, what: str) -> None:
        for task in tasks:
            if not task.path.is_file():
                task.store.write(task.path, task.run())

    monkeypatch.setattr(table_relations, "run", here)
    out = tmp_path / "out" / "relations.json"
    given = ["--dataset", str(scene.folder), "--count", "1", "--cache", str(tmp_path / "cache")]
    monkeypatch.setattr("sys.argv", ["table_relations.py", *given, "--out", str(out)])
    files = [out.with_suffix(end) for end in (".json", ".md", ".tex")]
    written = []
    for _ in range(2):
        table_relations.main()
        written.append([file.read_bytes() for file in files])
    assert written[0] == written[1]
    results = json.loads(out.read_text())
    assert results["labels"] == "the true mesh"
    assert results["groups"]["all"]["poses"] == PERTURBATIONS
