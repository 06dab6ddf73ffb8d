"""Answers are kept one by one, survive a kill, and are made again when code changes."""

from __future__ import annotations

import json
import multiprocessing
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark import code, few_view, scoring
from benchmark.catalogue import MULTI_METHODS, PAIR_METHODS, Method
from benchmark.methods.interface import Answer, Candidate, PairMethod, Placement
from benchmark.pairs import Pair
from benchmark.run import run
from benchmark.scenes import Scene
from benchmark.sets import FrameSet, largest_overlaps
from benchmark.store import Record, Store
from benchmark.table import Table, write
from benchmark.tasks import PairTask, SetTask, run_sets
from fewview import synthetic
from fewview.geometry import se3
from fewview.types import Frame


class Recorder(PairMethod):
    """Answers with the difference of mean depths, after ``wait_s``; breaks down on request."""

    def __init__(self, wait_s: float = 0.0, broken: bool = False) -> None:
        self.wait_s, self.broken = wait_s, broken

    def prepare(self, frame: Frame, turn: int = 0) -> float:
        return float(frame.depth.mean())

    def match(self, source: float, target: float) -> Answer:
        time.sleep(self.wait_s)
        if self.broken:
            raise ArithmeticError("no luck")
        pose = se3.pose(np.eye(3), np.array([source - target, 0.0, 0.0]))
        return Answer((Candidate(pose, score=1.0),))


def recorder(**arguments: object) -> Method:
    return Method("recorder", "tests.benchmark.test_run", "Recorder", arguments)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    folder = tmp_path_factory.mktemp("scenes") / "room"
    seed = synthetic.split_seed("validation", 3)
    synthetic.write(folder, synthetic.generate(seed, 4, width=160, height=120))
    return Scene(folder)


def pairs_of(scene: Scene, store: Store, method: Method) -> list[PairTask]:
    a, b, c, d = scene.names
    return [PairTask(store, method, scene, s, t) for s, t in ((a, b), (b, c), (c, d), (d, a))]


class TestRun:
    def test_answers_are_kept_and_not_made_again(self, scene: Scene, tmp_path: Path) -> None:
        tasks = pairs_of(scene, Store(tmp_path), recorder())
        run(tasks, 1, "test")
        before = [task.path.stat().st_mtime_ns for task in tasks]
        run(tasks, 1, "test")
        assert [task.path.stat().st_mtime_ns for task in tasks] == before

    def test_a_method_that_breaks_down_is_recorded(self, scene: Scene, tmp_path: Path) -> None:
        [task, *_] = pairs_of(scene, Store(tmp_path), recorder(broken=True))
        run([task], 1, "test")
        record: Record[Answer] = task.store.read(task.path)
        assert record.answer is None
        assert record.error == "ArithmeticError: no luck"
        pair = Pair(scene.name, task.source, task.target, 0.2, 30.0, (0.0, 0.0, 1.0))
        row = scoring.pair_row(task, pair)
        assert row["candidates"] == [] and row["selected"] is None

    @pytest.mark.slow
    def test_a_kill_loses_no_finished_pair(self, scene: Scene, tmp_path: Path) -> None:
        tasks = pairs_of(scene, Store(tmp_path), recorder(wait_s=0.7))
        child = multiprocessing.get_context("spawn").Process(target=run, args=(tasks, 1, "test"))
        child.start()
        deadline = time.monotonic() + 60.0
        while not tasks[0].path.is_file() and time.monotonic() < deadline:
            time.sleep(0.05)
        child.kill()
        child.join()
        kept = {task.path: task.path.read_bytes() for task in tasks if task.path.is_file()}
        assert kept
        run(tasks, 1, "test")
        assert all(task.path.is_file() for task in tasks)
        assert all(path.read_bytes() == content for path, content in kept.items())

    def test_settings_and_code_are_part_of_the_key(self) -> None:
        assert recorder().key != recorder(wait_s=1.0).key
        assert len(
            {PAIR_METHODS[n].key for n, m in PAIR_METHODS.items() if isinstance(m, Method)}
        ) == sum(isinstance(m, Method) for m in PAIR_METHODS.values())


class TestFingerprint:
    def test_reaches_what_a_method_imports(self) -> None:
        names = {path.name for path in code.reached("benchmark.methods.ours")}
        assert {"ours.py", "pairwise.py", "spectral.py", "se3.py"} <= names
        assert "fgr.py" not in names

    def test_scores_are_not_part_of_answers(self) -> None:
        folders = {path.parent.name for path in code.reached("benchmark.methods.ours")}
        assert "evaluation" not in folders


class TestSets:
    def test_set_after_its_pairs(self, scene: Scene, tmp_path: Path) -> None:
        task = SetTask(Store(tmp_path), MULTI_METHODS["identity"], scene, scene.names)
        run_sets([task], 1)
        record: Record[list[Placement | None]] = task.store.read(task.path)
        assert record.answer is not None and len(record.answer) == len(scene.names)
        assert len(task.pairs()) == 6
        row = scoring.set_row(task, dict.fromkeys(scene.names, 0.5))
        assert row["error"] is None and len(row["scans"]) == 4
        assert not any(scan["right"] for scan in row["scans"][1:]) or row["agreeing"] > 1

    def test_neighbours_only_for_methods_that_use_the_order(
        self, scene: Scene, tmp_path: Path
    ) -> None:
        task = SetTask(Store(tmp_path), MULTI_METHODS["fine2coarse"], scene, scene.names)
        assert list(task.indices) == [(0, 1), (1, 2), (2, 3)]

    def test_table_has_a_row_a_method_and_a_column_a_size(
        self, scene: Scene, tmp_path: Path
    ) -> None:
        store, method = Store(tmp_path), MULTI_METHODS["identity"]
        sets = [FrameSet("random", 0, scene.names), FrameSet("random", 0, scene.names[:3])]
        tasks = {"identity": [SetTask(store, method, scene, one.names) for one in sets]}
        run_sets(tasks["identity"], 1)
        placed = [(scene, one) for one in sets]
        results = few_view.results_of(tasks, placed, tmp_path)
        errors, left, overlaps = few_view.tables_of(results, "here")
        assert errors.head == ["method", "3 scans (1 sets)", "4 scans (1 sets)"]
        assert [row[0] for row in errors.rows] == [row[0] for row in left.rows] == ["identity"]
        assert [row[0] for row in overlaps.rows] == ["3 scans, identity", "4 scans, identity"]
        for row, size in zip(overlaps.rows, (3, 4), strict=True):
            assert sum(int(cell.split(";")[1]) for cell in row[1:] if cell) == size

    def test_the_largest_overlap_is_with_another_scan(self, scene: Scene, tmp_path: Path) -> None:
        found = largest_overlaps(scene, scene.names, tmp_path)
        matrix = scene.overlaps(tmp_path)
        np.fill_diagonal(matrix, 0.0)
        assert list(found.values()) == pytest.approx(matrix.max(axis=1))


class TestTable:
    TABLE = Table("A title", "A note.", ("method", "x"), [["group"], ["a_b", "< 10 %"]])

    def test_three_forms(self, tmp_path: Path) -> None:
        text = write(tmp_path / "t.json", {"x": 1.5}, [self.TABLE])
        assert json.loads((tmp_path / "t.json").read_text()) == {"x": 1.5}
        assert (tmp_path / "t.md").read_text() == text
        assert "| a_b | < 10 % |" in text
        latex = (tmp_path / "t.tex").read_text()
        assert r"a\_b & $<$ 10 \% \\" in latex and latex.count(r"\end{table}") == 1

    def test_no_number_that_is_none(self, tmp_path: Path) -> None:
        with pytest.raises(ValueError, match="not JSON compliant"):
            write(tmp_path / "t.json", {"x": float("nan")}, [self.TABLE])
        assert not list(tmp_path.iterdir())


class Turner(Recorder):
    """Needs a glance at both scans."""

    def glance(self, frame: Frame) -> float:
        return float(frame.depth.max())

    def turns(self, glances: Sequence[Any]) -> tuple[int, ...]:
        return tuple(int(glance > 0) for glance in glances)


def test_a_method_behind_a_local_one_is_shown_its_own_glances(scene: Scene, tmp_path: Path) -> None:
    blind = Method("blind", "tests.benchmark.test_run", "Recorder", local="icp")
    turner = Method("turner", "tests.benchmark.test_run", "Turner", local="icp")
    a, b, *_ = scene.names
    for method in (blind, turner):
        record = PairTask(Store(tmp_path), method, scene, a, b).run()
        assert record.answer is not None and len(record.answer.candidates) == 1
