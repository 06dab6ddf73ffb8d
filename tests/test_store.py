"""Records exact to the bit, the folder that keeps them, and runs that go on from it."""

from __future__ import annotations

import dataclasses
import enum
import io
import json
import shutil
import struct
import types
import typing
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fewview import pipeline, records, store, synthetic
from fewview.cli import BAD_INPUT, main
from fewview.completion.orientation import Glance
from fewview.config import Config, assign
from fewview.errors import FewviewError, ScanError
from fewview.records import RecordError, decode, encode
from fewview.store import Store
from fewview.types import (
    Array,
    CompletedScan,
    Frame,
    GlobalSolution,
    Intrinsics,
    Observer,
    PairResult,
    PairStatus,
    Reconstruction,
    Scan,
    ScanSet,
)

STORED = (Glance, CompletedScan, PairResult)
CAMERA = Intrinsics(4, 3, 5.0, 5.0, 1.5, 1.0)
AWKWARD = (-0.0, 0.1 + 0.2, float("inf"), float("nan"), 5e-324)


def example(hint: Any, rng: np.random.Generator) -> Any:
    """Some value of a type, its fields drawn by their type hints."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin in (types.UnionType, typing.Union):
        return example(inner[0], rng) if rng.integers(2) else None
    if origin is np.ndarray:
        (dtype,) = typing.get_args(inner[1])
        shape = rng.integers(4, size=rng.integers(4))
        values = rng.normal(scale=100.0, size=shape)
        return np.asarray(values).astype(dtype, order="F" if rng.integers(2) else "C")
    if origin is tuple:
        hints = inner[:1] * rng.integers(3) if inner[1:] == (Ellipsis,) else inner
        return tuple(example(h, rng) for h in hints)
    if origin is Mapping:
        return {example(inner[0], rng): example(inner[1], rng) for _ in range(rng.integers(4))}
    if dataclasses.is_dataclass(hint):
        fields = typing.get_type_hints(hint).items()
        make: Any = hint
        return make(**{name: example(field, rng) for name, field in fields})
    if issubclass(hint, enum.Enum):
        return rng.choice(list(hint))
    drawn: dict[type, Callable[[], Any]] = {
        bool: lambda: bool(rng.integers(2)),
        int: lambda: int(rng.integers(-9, 9)),
        float: lambda: AWKWARD[rng.integers(len(AWKWARD))],
        str: lambda: "room ä\n" + "".join(rng.choice(list('xyz"'), 3)),
    }
    return drawn[hint]()


def bits(value: Any) -> Any:
    """What two values have in common when they are equal to the bit, types and order included."""
    kind = type(value)
    if isinstance(value, np.ndarray):
        return kind, value.dtype, value.shape, value.flags.c_contiguous, value.tobytes()
    if dataclasses.is_dataclass(value):
        return kind, [bits(getattr(value, f.name)) for f in dataclasses.fields(value)]
    if isinstance(value, Mapping):
        return kind, [(bits(key), bits(part)) for key, part in value.items()]
    if isinstance(value, tuple):
        return kind, [bits(part) for part in value]
    return kind, struct.pack("d", value) if isinstance(value, float) else value


@pytest.mark.parametrize("kind", STORED)
def test_records_come_back_to_the_bit(kind: type) -> None:
    for seed in range(20):
        record = example(kind, np.random.default_rng(seed))
        data = encode(record)
        assert data == encode(record)
        assert bits(decode(data, kind)) == bits(record)


@pytest.mark.parametrize(
    "value", [np.float32(0.1), np.float64(0.1), np.bool_(True), np.int64(3), 3], ids=repr
)
def test_scalars_keep_their_type(value: Any) -> None:
    intrinsics = dataclasses.replace(CAMERA, fx=value)
    assert bits(decode(encode(intrinsics), Intrinsics)) == bits(intrinsics)


@pytest.mark.parametrize(
    "value", [{1, 2}, object(), np.array([None])], ids=["set", "object", "objects"]
)
def test_what_cannot_be_kept_is_refused(value: Any) -> None:
    with pytest.raises(TypeError, match="cannot be recorded"):
        encode(dataclasses.replace(CAMERA, fx=value))


def test_digests_tell_bits_apart() -> None:
    zeros = np.zeros((2, 3))
    different = (zeros, -zeros, zeros.T, zeros.astype(np.float32), np.zeros(6), 0.0, -0.0, 0, None)
    assert len({records.digest((value,)) for value in different}) == len(different)
    assert records.digest(zeros) == records.digest(np.asfortranarray(zeros))


class Trap:
    """Tells when it is unpickled."""

    sprung = False

    def __reduce__(self) -> tuple[Callable[[], None], tuple[()]]:
        return spring, ()


def spring() -> None:
    Trap.sprung = True


def trapped() -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, np.array([Trap()]))
    return buffer.getvalue()


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: b"",
        lambda data: data[: len(data) // 2],
        lambda data: data[:200] + bytes([data[200] ^ 1]) + data[201:],
        lambda data: b"not an archive",
        lambda data: encode(CAMERA),
        lambda data: trapped(),
    ],
    ids=["empty", "cut", "one bit", "text", "other class", "pickle"],
)
def test_damaged_and_foreign_records_are_passed_over(
    damage: Callable[[bytes], bytes], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    record = example(PairResult, np.random.default_rng(3))
    kept = Store(tmp_path / "store")
    kept.put(record, "origin")
    (path,) = kept.folder.iterdir()
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(RecordError):
        decode(path.read_bytes(), PairResult)
    assert kept.get(PairResult, "origin") is None
    assert not Trap.sprung
    (line,) = caplog.messages
    assert path.name in line and "\n" not in line
    kept.put(record, "origin")
    assert bits(kept.get(PairResult, "origin")) == bits(record)


def test_records_are_found_by_class_origin_and_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = Store(tmp_path / "store")
    kept.put(CAMERA, ("scan", 1))
    assert kept.get(Intrinsics, ("scan", 1)) == CAMERA
    assert Store(tmp_path / "store").get(Intrinsics, ("scan", 1)) == CAMERA
    assert kept.get(Intrinsics, ("scan", 2)) is None
    assert kept.get(Glance, ("scan", 1)) is None
    monkeypatch.setattr(store, "code_version", lambda: "another")
    assert kept.get(Intrinsics, ("scan", 1)) is None


def test_the_folder_appears_with_the_first_record(tmp_path: Path) -> None:
    kept = Store(tmp_path / "store")
    assert list(tmp_path.iterdir()) == []
    kept.put(CAMERA, 1)
    assert [p.suffix for p in kept.folder.iterdir()] == [".npz"]


def test_folders_that_cannot_be_used_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "file"
    file.touch()
    with pytest.raises(FewviewError, match="is a file"):
        Store(file)
    with pytest.raises(FewviewError, match="no such folder"):
        Store(tmp_path / "none" / "store")

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "touch", refuse)
    with pytest.raises(FewviewError, match="Permission denied.*--no-store"):
        Store(tmp_path)


def test_a_bad_store_ends_the_command_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    out = ["--out", str(tmp_path / "mesh.ply"), "--store", str(tmp_path / "file")]
    assert main(["reconstruct", "nowhere", *out]) == BAD_INPUT
    assert "--store" in capsys.readouterr().err


def test_a_full_disk_costs_one_line_and_no_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    kept = Store(tmp_path / "store")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    kept.put(CAMERA, 1)
    kept.put(CAMERA, 2)
    assert len(caplog.messages) == 1 and "No space left" in caplog.messages[0]
    assert list(kept.folder.iterdir()) == []


@dataclasses.dataclass(frozen=True)
class Pixels:
    """A frame source of tiny images of one value; none at all cannot be read."""

    value: int | None

    def load(self) -> Frame:
        if self.value is None:
            raise ScanError("unusable")
        shape = CAMERA.height, CAMERA.width
        return Frame(np.full((*shape, 3), self.value, np.uint8), np.ones(shape, np.float32), CAMERA)


class Work(Observer):
    """Quick stand-ins for the steps, which note what they were asked, and what was told."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.asked: list[str] = []
        self.told: list[str] = []
        self.turns: dict[int, int] = {}
        for step in ("glance", "quarter_turns", "complete", "prepare", "match_pair"):
            monkeypatch.setattr(pipeline, step, getattr(self, step))
        nothing = GlobalSolution((), (), {}, {}, ())
        monkeypatch.setattr(pipeline.global_stage, "solve", lambda *_: nothing)

    def glance(self, frame: Frame) -> Glance:
        self.asked.append("glance")
        return Glance((), np.full(4, frame.colour[0, 0, 0], np.float64))

    def quarter_turns(self, glances: list[Glance]) -> np.ndarray:
        return np.array([self.turns.get(int(g.upright[0]), 0) for g in glances])

    def complete(
        self, name: str, frame: Frame, turns: int, features: object, seed: int, up: Array | None
    ) -> CompletedScan:
        self.asked.append(name)
        record: CompletedScan = example(CompletedScan, np.random.default_rng(seed))
        return dataclasses.replace(record, name=name, quarter_turns=turns)

    def prepare(self, scan: CompletedScan) -> CompletedScan:
        self.asked.append(f"prepare {scan.name}")
        return scan

    def match_pair(
        self, source: CompletedScan, target: CompletedScan, pair: tuple[int, int], config: Config
    ) -> PairResult:
        self.asked.append(source.name + target.name)
        return PairResult(*pair, PairStatus.OK, (), source.name + target.name)

    def scan_completed(self, index: int, frame: Frame, completed: CompletedScan) -> None:
        self.told.append(f"{index}{completed.name}{frame.colour[0, 0, 0]}")

    def pair_matched(self, result: PairResult) -> None:
        self.told.append(f"{result.source}{result.target}{result.reason}")

    def run(
        self, folder: Path | None, scans: str, seed: int = 0, **values: int | None
    ) -> Reconstruction:
        """A run of scans called by letters, with pixels of their own."""
        return self.configured(folder, scans, Config(), seed, **values)

    def configured(
        self, folder: Path | None, names: str, config: Config, seed: int = 0, **values: int | None
    ) -> Reconstruction:
        self.asked, self.told = [], []
        scans = tuple(
            Scan(name, CAMERA, Pixels(values.get(name, ord(name) - ord("a")))) for name in names
        )
        kept = None if folder is None else Store(folder)
        return pipeline.reconstruct(
            ScanSet("test", scans, 1.0), config, seed, 1, [self], store=kept
        )


@pytest.fixture
def work(monkeypatch: pytest.MonkeyPatch) -> Work:
    return Work(monkeypatch)


def test_a_further_scan_costs_only_its_pairs(work: Work, tmp_path: Path) -> None:
    folder = tmp_path / "store"
    work.run(folder, "ac")
    assert work.asked == ["glance", "glance", "a", "c", "prepare a", "prepare c", "ac"]
    result = work.run(folder, "abc")
    assert work.asked == ["glance", "b", *(f"prepare {s}" for s in "abc"), "ab", "bc"]
    assert work.told == ["0a0", "1b1", "2c2", "01ab", "02ac", "12bc"]
    again = work.run(folder, "abc")
    assert work.asked == []
    assert work.told == ["0a0", "1b1", "2c2", "01ab", "02ac", "12bc"]
    fresh = work.run(None, "abc")
    for other in (result, again):
        assert bits(other.completed) == bits(fresh.completed)
        assert bits(other.pairs) == bits(fresh.pairs)


@pytest.mark.parametrize(
    ("setting", "asked"),
    [
        ("features.max_patches=3", ["a", "b", "prepare a", "prepare b", "ab"]),
        ("matching.top_k=3", ["prepare a", "prepare b", "ab"]),
        ("refinement.alpha_r=0.5", ["prepare a", "prepare b", "ab"]),
        ("global_stage.restarts=3", []),
        ("fusion.voxel_m=0.1", []),
    ],
)
def test_settings_cost_what_depends_on_them(
    setting: str, asked: list[str], work: Work, tmp_path: Path
) -> None:
    work.run(tmp_path / "store", "ab")
    work.configured(tmp_path / "store", "ab", assign(Config(), (setting,)))
    assert work.asked == asked


def test_another_seed_other_pixels_and_another_turn_are_other_scans(
    work: Work, tmp_path: Path
) -> None:
    folder = tmp_path / "store"
    work.run(folder, "abc")
    work.run(folder, "abc", seed=1)
    assert [step for step in work.asked if len(step) <= 2] == ["a", "b", "c", "ab", "ac", "bc"]
    work.run(folder, "abc", c=99)
    assert [step for step in work.asked if len(step) <= 2] == ["c", "ac", "bc"]
    work.turns = {1: 3}
    work.run(folder, "abc")
    assert [step for step in work.asked if len(step) <= 2] == ["b", "ab", "bc"]


def test_what_was_finished_before_an_interruption_is_kept(
    work: Work, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(a: CompletedScan, b: CompletedScan, *rest: Any) -> PairResult:
        if (a.name, b.name) == ("b", "c"):
            raise KeyboardInterrupt
        return work.match_pair(a, b, *rest)

    monkeypatch.setattr(pipeline, "match_pair", interrupted)
    with pytest.raises(KeyboardInterrupt):
        work.run(tmp_path / "store", "abc")
    monkeypatch.setattr(pipeline, "match_pair", work.match_pair)
    work.run(tmp_path / "store", "abc")
    assert work.asked == ["prepare b", "prepare c", "bc"]


def test_pairs_that_failed_are_tried_again(
    work: Work, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(*_: Any) -> PairResult:
        raise RuntimeError("out of memory")

    monkeypatch.setattr(pipeline, "match_pair", failing)
    (pair,) = work.run(tmp_path / "store", "ab").pairs
    assert pair.status is PairStatus.FAILED
    monkeypatch.setattr(pipeline, "match_pair", work.match_pair)
    (pair,) = work.run(tmp_path / "store", "ab").pairs
    assert pair.status is PairStatus.OK


def test_an_unusable_scan_leaves_no_store(work: Work, tmp_path: Path) -> None:
    with pytest.raises(ScanError):
        work.run(tmp_path / "store", "abc", c=None)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_same_bytes_whatever_came_from_the_store(tmp_path: Path) -> None:
    scene = synthetic.generate(synthetic.split_seed("test", 1), 3, seed=2, mode="spread")
    scans, fewer = tmp_path / "scans", tmp_path / "fewer"
    synthetic.write(scans, scene)
    shutil.copytree(scans, fewer, ignore=shutil.ignore_patterns("scan-001*"))

    def run(folder: Path, name: str, *options: str) -> dict[str, object]:
        out = tmp_path / name
        assert main(["reconstruct", str(folder), "--out", str(out), "--no-rrd", *options]) != 2
        report = json.loads(out.with_suffix(".json").read_text())
        del report["timings_s"], report["mesh"]["path"], report["components"]
        return {"mesh": out.read_bytes(), "report": report}

    shared = ("--store", str(tmp_path / "shared"))
    nothing = run(scans, "nothing.ply", "--no-store")
    assert sorted(tmp_path.glob("*.store")) == []
    run(fewer, "fewer.ply", *shared)
    part = run(scans, "part.ply", *shared)
    everything = run(scans, "everything.ply", *shared)
    assert nothing == part == everything
    counts = {k: len(list((tmp_path / "shared").glob(f"{k.__name__}-*"))) for k in STORED}
    assert counts == {Glance: 3, CompletedScan: 3, PairResult: 3}
    run(fewer, "beside.ply")
    assert (tmp_path / "beside.store").is_dir()


def test_the_seed_of_a_scan_follows_from_its_name() -> None:
    seeds = {pipeline.scan_seed(seed, name) for seed in (0, 1) for name in ("a", "b", "0/a")}
    assert len(seeds) == 6
    assert pipeline.scan_seed(0, "a") == pipeline.scan_seed(0, "a")
