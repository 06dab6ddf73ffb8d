"""The recording: written, read back, whole or absent, and opening on the answer."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rerun as rr
from hypothesis import given
from hypothesis import strategies as st
from rerun.chunk import Chunk, RrdReader

from fewview.errors import FewviewError
from fewview.geometry import camera, se3
from fewview.recording import Recorder, layout, pictures, tables, view, viewer
from fewview.types import (
    Alternative,
    AlternativePlace,
    Array,
    CandidateOrigin,
    ColouredMesh,
    CompletedRoom,
    CompletedScan,
    Component,
    EdgeReport,
    Evidence,
    FeatureSet,
    Frame,
    GlobalSolution,
    Intrinsics,
    Levelling,
    Observer,
    PairResult,
    PairStatus,
    PoseCandidate,
    Representation,
    RingScan,
    Scan,
    ScanPlacement,
    ScanSet,
    Surface,
)

CAMERA = Intrinsics(400, 300, 300.0, 300.0, 199.5, 149.5)
EMPTY_RING = RingScan(np.zeros((64, 256, 3), np.uint8), np.zeros((64, 256), np.float32), np.eye(4))
NAMES = ("room-0", "room 1/a|b *x*", "room-2", "room-3", "room-4")
UNPLACED = 4
REASON = "no pair with another scan is believable"
MESH = ColouredMesh(np.eye(3), np.array([[0, 1, 2]]), np.full((3, 3), 90, dtype=np.uint8))


class Pixels:
    """A frame source that has its frame."""

    def __init__(self, frame: Frame) -> None:
        self._frame = frame

    def load(self) -> Frame:
        return self._frame


def _frame(yaw: float) -> Frame:
    """A camera in the middle of a box room of 4 x 4 m, colours by direction."""
    rays = camera.backproject(np.ones((300, 400), dtype=np.float32), CAMERA).reshape(-1, 3)
    turned = rays @ se3.rotation_exp(np.array([0.0, yaw, 0.0])).T
    reach = np.min(np.array([2.0, 1.3, 2.0]) / np.maximum(np.abs(turned), 1e-9), axis=1)
    colour = np.uint8(127 + 127 * turned / np.linalg.norm(turned, axis=1, keepdims=True))
    depth = np.asarray(reach.reshape(300, 400), dtype=np.float32)
    return Frame(colour.reshape(300, 400, 3), depth, CAMERA)


def _completed(name: str, frame: Frame) -> CompletedScan:
    points = camera.backproject(frame.depth, CAMERA)[::10, ::10].reshape(-1, 3).astype(float)
    pixels = np.stack(np.meshgrid(np.arange(0, 400, 10), np.arange(0, 300, 10)), -1)
    count = len(points)
    sparse = FeatureSet(
        "xfeat",
        Representation.KEYPOINTS,
        points,
        np.zeros_like(points),
        np.zeros((count, 4), np.float32),
        np.ones(count, bool),
        np.ones(count, np.float32),
        pixels.reshape(-1, 2).astype(np.float32),
    )
    behind = FeatureSet(
        "planes",
        Representation.PLANES,
        points * [1.0, 1.0, -1.0],
        sparse.normals,
        sparse.descriptors,
        sparse.observed,
        sparse.confidence,
    )
    upright = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    return CompletedScan(
        name,
        (CAMERA.width, CAMERA.height),
        0,
        CAMERA,
        frame.depth,
        Surface(
            points, np.zeros_like(points), np.zeros((count, 3), np.float32), np.zeros(count, int)
        ),
        (),
        Levelling(upright, 0.9, True, -1.3),
        CompletedRoom(EMPTY_RING),
        {"xfeat": sparse, "planes": behind},
    )


def _pose(index: int) -> Array:
    facing = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    yaw = se3.rotation_exp(np.array([0.0, 0.3 * index, 0.0]))
    return se3.pose(facing @ yaw, np.array([0.2 * index, 0.0, 1.3]))


def _candidate(rank: int) -> PoseCandidate:
    support = {Representation.KEYPOINTS: 40, Representation.PLANES: 0}
    matches = np.stack([np.arange(0, 1200, 10)] * 2, axis=1)
    return PoseCandidate(
        rank,
        np.eye(4),
        CandidateOrigin.SPECTRAL,
        12.0,
        0.9 / (rank + 1),
        Evidence(0.02, 0.4, 0.01, support),
        np.eye(6),
        {"xfeat": matches, "planes": matches},
    )


def _pairs() -> list[PairResult]:
    both = (_candidate(0), _candidate(1))
    pairs = [PairResult(a, b, PairStatus.OK, both) for a in range(4) for b in range(a + 1, 4)]
    lonely = (PairResult(a, 4, PairStatus.NOTHING_BELIEVABLE, (), "walls only") for a in range(4))
    return [*pairs, *lonely]


def _solution() -> GlobalSolution:
    """Scans 0, 1 in one component, 2, 3 in another, 4 in none; 0-1 and 2-3 selected."""
    placements = tuple(
        ScanPlacement(name, i // 2, _pose(i), 0.9, None) for i, name in enumerate(NAMES[:4])
    )
    return GlobalSolution(
        (*placements, ScanPlacement(NAMES[UNPLACED], None, None, 0.2, REASON)),
        (Component((0, 1), "floor"), Component((2, 3), "gravity", "room-1 to room-2, 0.3")),
        {(0, 1): 1, (2, 3): 0},
        {i: _pose(i) @ se3.exp(np.full(6, 0.05)) for i in range(4)},
        (EdgeReport(0, 1, 1, 0.9, 0.1, 0.02, 0.1, 0.01), EdgeReport(2, 3, 0, 0.5, 0.1, 0, 0.1, 0)),
    )


def _run(observer: Observer) -> None:
    frames = [_frame(0.3 * i) for i in range(5)]
    scans = (Scan(n, CAMERA, Pixels(f)) for n, f in zip(NAMES, frames, strict=True))
    observer.started(ScanSet("7scenes", tuple(scans), 0.001, ("depth in millimetres",)))
    for i, frame in enumerate(frames):
        observer.scan_completed(i, frame, _completed(NAMES[i], frame))
    for pair in _pairs():
        observer.pair_matched(pair)
    observer.solved(_solution())
    for component in (0, 1):
        observer.mesh_fused(component, MESH)
    observer.finished({"features": 1.5, "pairs": 3.0})


@pytest.fixture(scope="module", autouse=True)
def strict() -> Iterator[None]:
    """Rerun warns of what it cannot log; here that is an error."""
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "mesh.rrd"
    with Recorder(path, view=False) as recorder:
        _run(recorder)
        recorder.log("mesh written")
    return path


@pytest.fixture(scope="module")
def chunks(recording: Path) -> list[Chunk]:
    return list(RrdReader(recording).stream().to_chunks())


Read = Callable[[str, str], list[Any]]


@pytest.fixture(scope="module")
def read(chunks: list[Chunk]) -> Read:
    """All logged values of a component of an entity, in the order of the steps."""

    def values(entity: str, component: str) -> list[Any]:
        rows: list[tuple[int, Any]] = []
        for chunk in chunks:
            batch = chunk.to_record_batch()
            if chunk.entity_path == entity and component in batch.schema.names:
                steps = batch.column(layout.TIMELINE).to_pylist()
                rows += zip(steps, batch.column(component).to_pylist(), strict=True)
        return [value for _, value in sorted(rows, key=lambda row: row[0]) if value is not None]

    return values


def test_everything_is_recorded(chunks: list[Chunk]) -> None:
    odd = layout.path(NAMES[1])
    expected = {
        "/summary",
        "/candidates",
        "/log",
        "/timings/features",
        "/timings/pairs",
        "/scans/room-0/rgb",
        "/scans/room-0/depth",
        "/unplaced/room-4/points",
        f"/world/scans{odd}",
        f"/world/scans{odd}/points",
        f"/world/scans{odd}/image",
        f"/world/scans{odd}/image/rgb",
        f"/world/scans{odd}/image/depth",
        "/world/pose_graph/before",
        "/world/pose_graph/after",
        "/world/components/0/mesh",
        "/world_1/scans/room-2/image",
        "/world_1/pose_graph/after",
        "/world_1/components/1/mesh",
        f"{layout.pair(NAMES[0], NAMES[1])}/images",
        f"{layout.pair(NAMES[0], NAMES[1])}/matches/xfeat",
        f"{layout.pair(NAMES[0], NAMES[1])}/candidates",
    }
    expected = {entity if entity.startswith("/") else f"/{entity}" for entity in expected}
    assert expected <= {chunk.entity_path for chunk in chunks}


def test_steps_are_one_timeline(chunks: list[Chunk]) -> None:
    logged = [c for c in chunks if c.entity_path == "/log"]
    steps = {s for c in logged for s in c.to_record_batch().column(layout.TIMELINE).to_pylist()}
    assert steps == set(layout.Step)


def test_scans_stand_where_they_were_placed(read: Read) -> None:
    for index, root in ((0, "/world"), (2, "/world_1"), (3, "/world_1")):
        entity = f"{root}/scans/{NAMES[index]}"
        (translation,) = read(entity, "Transform3D:translation")
        (quaternion,) = read(entity, "Transform3D:quaternion")
        x, y, z, w = np.array(quaternion[0])
        axis = 2 * np.arctan2(np.linalg.norm([x, y, z]), w)
        rotation = se3.rotation_exp(axis * np.array([x, y, z]) / np.linalg.norm([x, y, z]))
        np.testing.assert_allclose(translation[0], _pose(index)[:3, 3], atol=1e-6)
        np.testing.assert_allclose(rotation, _pose(index)[:3, :3], atol=1e-5)


def test_unplaced_scan_is_in_no_world_and_has_its_reason(chunks: list[Chunk], read: Read) -> None:
    name = NAMES[UNPLACED]
    homes = {c.entity_path for c in chunks if name in c.entity_path}
    assert all(home.startswith(("/scans/", "/unplaced/", "/pairs/")) for home in homes)
    assert read(f"/unplaced/{name}/name", "Points3D:labels")[-1] == [f"{name}: {REASON}"]
    assert REASON in read("/summary", "TextDocument:text")[-1][0]


def test_placed_scans_leave_the_gallery(chunks: list[Chunk]) -> None:
    cleared = {
        chunk.entity_path
        for chunk in chunks
        if "Clear:is_recursive" in chunk.to_record_batch().schema.names
        and chunk.to_record_batch().column("Clear:is_recursive").to_pylist() == [[True]]
    }
    assert cleared == {f"/unplaced{layout.path(name)}" for name in NAMES[:UNPLACED]}


def test_pose_graph_edges_join_the_cameras(read: Read) -> None:
    (after,) = read("/world/pose_graph/after", "LineStrips3D:strips")
    np.testing.assert_allclose(after[0], [_pose(0)[:3, 3], _pose(1)[:3, 3]], atol=1e-6)
    (before,) = read("/world/pose_graph/before", "LineStrips3D:strips")
    assert np.linalg.norm(np.subtract(before, after)) > 0.05


def test_images_and_depth_survive(read: Read) -> None:
    (blob,) = read("/scans/room-0/depth", "EncodedDepthImage:blob")
    (meter,) = read("/scans/room-0/depth", "EncodedDepthImage:meter")
    depth = cv2.imdecode(np.array(blob[0], dtype=np.uint8), cv2.IMREAD_UNCHANGED) / meter[0]
    np.testing.assert_allclose(depth, _frame(0.0).depth, atol=6e-4)
    (blob,) = read("/scans/room-0/rgb", "EncodedImage:blob")
    colour = cv2.imdecode(np.array(blob[0], dtype=np.uint8), cv2.IMREAD_COLOR_RGB)
    assert np.abs(colour.astype(int) - _frame(0.0).colour).mean() < 3.0


def test_matches_run_across_the_two_images(read: Read) -> None:
    entity = f"/pairs/{NAMES[2]}--{NAMES[3]}"
    (strips,) = read(f"{entity}/matches/xfeat", "LineStrips2D:strips")
    lines = np.array(strips)
    assert lines.shape == (pictures.MAX_MATCHES, 2, 2)
    np.testing.assert_allclose(
        lines[:, 1] - lines[:, 0], [[pictures.PREVIEW_WIDTH, 0]] * len(lines)
    )
    assert read(f"{entity}/matches/planes", "LineStrips2D:strips") == []


def test_candidates_are_listed(read: Read) -> None:
    (text,) = read("/candidates", "TextDocument:text")
    rows = text[0].splitlines()
    assert len(rows) == 2 + 6 * 2 + 4
    assert sum("selected" in row for row in rows) == 2
    assert sum("walls only" in row for row in rows) == 4
    cells = {len(re.split(r"(?<!\\)\|", row)) for row in rows}
    assert len(cells) == 1


def test_log_and_summary(read: Read) -> None:
    lines = [text[0] for text in read("/log", "TextLog:text")]
    assert "mesh written" in lines
    assert any("depth in millimetres" in line for line in lines)
    first, *_, last = (text[0] for text in read("/summary", "TextDocument:text"))
    assert first.startswith("# 5 scans")
    assert last.startswith("# 2 of 5 scans in the largest of 2 components\n")
    assert "2 of 5 scans in the largest of 2 components" in lines
    assert "features" in last


def test_headline_of_one_component_and_of_none() -> None:
    solution = _solution()
    first = tuple(ScanPlacement(n, None, None, 0.0, REASON) for n in NAMES[2:])
    one = replace(
        solution,
        placements=(*solution.placements[:2], *first),
        components=solution.components[:1],
    )
    assert one.headline == "2 of 5 scans placed"
    assert replace(one, components=()).headline == "0 of 5 scans placed"


def test_other_answers_name_what_they_move() -> None:
    solution = _solution()
    assert "Other answers" not in tables.answer(solution)
    places = tuple(AlternativePlace(i, 0, _pose(i)) for i in (0, 3))
    other = replace(solution, alternatives=(Alternative(1.0, places),))
    assert f"| {NAMES[0]}, {NAMES[3]} | 0.37 |" in tables.answer(other).splitlines()


def test_reasons_stand_below_the_tables() -> None:
    lines = tables.answer(_solution()).splitlines()
    assert f"**{NAMES[UNPLACED]}**: {REASON}" in lines
    assert not any("note" in line or REASON in line for line in lines if line.startswith("|"))


@given(
    st.integers(0, 1000),
    st.tuples(*[st.floats(0.5, 8.0)] * 3),
    st.tuples(*[st.floats(-4.0, 4.0)] * 3),
)
def test_the_eye_sees_all_cameras_and_walls(
    seed: int, size: tuple[float, ...], middle: tuple[float, ...]
) -> None:
    rng = np.random.default_rng(seed)
    walls = np.stack(np.meshgrid(*[(0.0, 1.0)] * 3), axis=-1).reshape(-1, 3).repeat(20, axis=0)
    centres = rng.uniform(-1.0, 1.0, (4, 3)) + middle
    eye = layout.eye(np.concatenate([walls * size, centres]), centres)
    forward = (eye.target - eye.position) / np.linalg.norm(eye.target - eye.position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    seen = np.concatenate([walls * size, centres]) - eye.position
    x, y, z = (seen @ axis for axis in (right, np.cross(forward, right), forward))
    assert (z > 0).all()
    assert np.maximum(np.abs(x / z), np.abs(y / z)).max() == pytest.approx(layout.HALF_VIEW)


def test_rerun_accepts_the_file(recording: Path) -> None:
    program = shutil.which("rerun", path=str(Path(sys.executable).parent))
    assert program is not None
    result = subprocess.run([program, "rrd", "verify", str(recording)], capture_output=True)
    assert result.returncode == 0, result.stderr


def test_it_opens_on_the_answer(recording: Path) -> None:
    reader = RrdReader(recording)
    (blueprint,) = reader.blueprints()
    views: dict[str, str] = {}
    eyes: list[Any] = []
    for chunk in reader.stream(store=blueprint).to_chunks():
        batch = chunk.to_record_batch()
        if "EyeControls3D:position" in batch.schema.names:
            eyes += batch.column("EyeControls3D:position").to_pylist()
        if "ViewBlueprint:space_origin" in batch.schema.names:
            ((name,),) = batch.column("ViewBlueprint:display_name").to_pylist()
            ((views[name],),) = batch.column("ViewBlueprint:space_origin").to_pylist()
    assert views["Answer"] == "world"
    assert views["Component 1"] == "world_1"
    assert views["Scans not placed"] == "unplaced"
    assert views[f"{NAMES[2]} - {NAMES[3]}"] == f"/pairs/{NAMES[2]}--{NAMES[3]}"
    assert {"Summary", "Candidates", "Log", "Timings"} <= set(views)
    assert len(eyes) == 3
    centres = np.stack([_pose(i)[:3, 3] for i in (0, 1)])
    of_the_mesh = layout.eye(MESH.vertices, centres).position
    assert any(np.allclose(eye[0], of_the_mesh, atol=1e-5) for eye in eyes)


def test_recording_only_reads(tmp_path: Path) -> None:
    frame, solution = _frame(0.0), _solution()
    arrays: list[np.ndarray[Any, Any]] = [frame.colour, frame.depth]
    for values in (*arrays, *solution.initial_world_T_scan.values()):
        values.setflags(write=False)
    with Recorder(tmp_path / "a.rrd", view=False) as recorder:
        recorder.started(ScanSet("7scenes", (Scan("a", CAMERA, Pixels(frame)),), 0.001))
        recorder.scan_completed(0, frame, _completed("a", frame))


def test_only_the_finished_file_has_the_name(tmp_path: Path) -> None:
    path = tmp_path / "mesh.rrd"
    path.write_bytes(b"the last run")
    with Recorder(path, view=False) as recorder:
        _run(recorder)
        assert path.read_bytes() == b"the last run"
    assert [p.name for p in tmp_path.iterdir()] == ["mesh.rrd"]
    assert path.stat().st_size > 10_000


@pytest.mark.parametrize("error", [FewviewError("bad"), KeyboardInterrupt()])
def test_nothing_remains_after_an_exception(tmp_path: Path, error: BaseException) -> None:
    with (
        pytest.raises(type(error)),
        Recorder(tmp_path / "mesh.rrd", view=False) as recorder,
    ):
        _run(recorder)
        raise error
    assert list(tmp_path.iterdir()) == []


def test_nothing_placed_is_recorded(tmp_path: Path) -> None:
    path = tmp_path / "mesh.rrd"
    placements = tuple(ScanPlacement(n, None, None, 0.0, REASON) for n in ("a", "b"))
    with Recorder(path, view=False) as recorder:
        scans = tuple(Scan(n, CAMERA, Pixels(_frame(0.0))) for n in ("a", "b"))
        recorder.started(ScanSet("tum", scans, 0.0002))
        for i, scan in enumerate(scans):
            recorder.scan_completed(i, scan.load(), _completed(scan.name, scan.load()))
        recorder.pair_matched(PairResult(0, 1, PairStatus.NO_CORRESPONDENCES, ()))
        recorder.solved(GlobalSolution(placements, (), {}, {}, ()))
        recorder.finished({})
    entities = {chunk.entity_path for chunk in RrdReader(path).stream().to_chunks()}
    assert not any(e.startswith("/world/") for e in entities)
    assert {"/unplaced/a/points", "/unplaced/b/points"} <= entities


def test_unwritable_target_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(FewviewError, match=r"absent.*mesh\.rrd"):
        Recorder(tmp_path / "absent" / "mesh.rrd", view=False)


def test_recorder_without_a_target_is_refused() -> None:
    with pytest.raises(ValueError, match="file"):
        Recorder(None, view=False)


def test_view_needs_a_file_and_a_display(
    tmp_path: Path, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(FewviewError, match=r"absent\.rrd"):
        view(tmp_path / "absent.rrd")
    monkeypatch.setattr(sys, "platform", "linux")
    for variable in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(variable, raising=False)
    with pytest.raises(FewviewError, match="display"):
        view(recording)
    with pytest.raises(FewviewError, match="display"):
        Recorder(tmp_path / "mesh.rrd", view=True)
    assert list(tmp_path.iterdir()) == []


def test_viewer_that_stops_is_a_clear_error(
    tmp_path: Path, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(viewer, "_executable", lambda: shutil.which("false"))
    monkeypatch.setattr(viewer, "PORT", 1)
    monkeypatch.setattr(viewer, "SETTLE_S", 0.0)
    with pytest.raises(FewviewError, match="does not start"):
        Recorder(tmp_path / "mesh.rrd", view=True)
    with pytest.raises(FewviewError, match="exit code 1"):
        view(recording)
    assert list(tmp_path.iterdir()) == []


def test_light_mesh_keeps_the_surface() -> None:
    side = 60
    x, y = (v.ravel() for v in np.meshgrid(np.arange(side), np.arange(side)))
    vertices = np.stack([x, y, 0 * x], axis=1) / side
    corner = (x + side * y)[(x < side - 1) & (y < side - 1)]
    upper = np.stack([corner, corner + 1, corner + side + 1], axis=1)
    lower = np.stack([corner, corner + side + 1, corner + side], axis=1)
    colours = np.full((side * side, 3), (10, 200, 30), dtype=np.uint8)
    mesh = ColouredMesh(vertices, np.concatenate([upper, lower]), colours)
    small = pictures.light(mesh, limit=400)
    assert 100 < len(small.vertices) < 600
    assert small.faces.max() < len(small.vertices)
    assert (small.colours == (10, 200, 30)).all()
    assert 0.85 < _area(small) / _area(mesh) <= 1.0
    assert pictures.light(mesh, limit=side * side) is mesh


def _area(mesh: ColouredMesh) -> float:
    a, b, c = mesh.vertices[mesh.faces].swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    assert (normals[:, 2] > 0).all()
    return float(np.linalg.norm(normals, axis=1).sum() / 2)


@given(st.lists(st.text(min_size=1), min_size=2, max_size=5, unique=True))
def test_short_names_stay_different(names: list[str]) -> None:
    short = layout.short(names)
    assert len(set(short)) == len(names)
    assert all(name.endswith(brief) and brief for name, brief in zip(names, short, strict=True))


def test_short_names_drop_the_common_words() -> None:
    assert layout.short(["frame-000010", "frame-000120"]) == ("000010", "000120")


@given(st.text(max_size=40))
def test_any_text_stays_in_its_table_cell(text: str) -> None:
    cell = tables.escaped(text)
    assert "\n" not in cell
    assert re.search(r"(?<!\\)(\\\\)*\|", cell) is None


@given(st.text(min_size=1, max_size=20), st.text(min_size=1, max_size=20))
def test_entity_paths_keep_names_apart(a: str, b: str) -> None:
    assert len(re.findall(r"(?<!\\)/", layout.path("scans", a))) == 2
    assert (layout.path(a) == layout.path(b)) == (a == b)
