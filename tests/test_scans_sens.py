"""Hostile ``.sens`` files end in one `ScanError`, with little memory."""

from __future__ import annotations

import re
import struct
import tempfile
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from fewview import scans
from fewview.errors import ScanError
from fewview.scans import assembly
from tests import scan_writers as w

GOOD = w.sens_bytes(w.samples(2, colour_size=(16, 12), depth_size=(16, 12)))
HEADER_BYTES = 4 + 8 + 15 + 256 + 8 + 16 + 4 + 8
FRAME_BYTES = 64 + 32


def read_all(content: bytes) -> None:
    """Everything that a user can ask of a file; only `ScanError` may come out."""
    with tempfile.TemporaryDirectory() as folder:
        path = w.put(Path(folder) / "scene.sens", content)
        for ask in (scans.inspect, scans.truth):
            try:
                ask(path)
            except ScanError as error:
                assert "\n" not in str(error) and "scene.sens" in str(error)


def message_of(content: bytes, folder: Path) -> str:
    path = w.put(folder / "scene.sens", content)
    with pytest.raises(ScanError) as caught:
        scans.inspect(path)
    return str(caught.value)


def test_the_whole_file_is_good(tmp_path: Path) -> None:
    path = w.put(tmp_path / "scene.sens", GOOD)
    assert len(scans.inspect(path).scans) == len(scans.truth(path)) == 2


@settings(max_examples=60, deadline=None)
@given(st.integers(0, len(GOOD) - 1))
@example(0)
@example(HEADER_BYTES)
def test_truncated_anywhere(length: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        assert "scene.sens" in message_of(GOOD[:length], Path(folder))


@settings(max_examples=150, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.one_of(st.integers(0, HEADER_BYTES + FRAME_BYTES), st.integers(0, len(GOOD) - 1)),
            st.binary(min_size=1, max_size=8),
        ),
        min_size=1,
        max_size=4,
    )
)
@example([(HEADER_BYTES - 8, b"\xff" * 8)])
@example([(HEADER_BYTES + 80, b"\xff" * 8)])
@example([(HEADER_BYTES - 28, b"\xff" * 8)])
def test_overwritten_bytes(changes: list[tuple[int, bytes]]) -> None:
    content = bytearray(GOOD)
    for at, new in changes:
        content[at : at + len(new)] = new
    read_all(bytes(content))


@settings(max_examples=40, deadline=None)
@given(st.binary(max_size=600))
def test_noise(content: bytes) -> None:
    read_all(content)
    read_all(GOOD[:HEADER_BYTES] + content)


HEADERS: dict[str, tuple[w.SensHeader, str]] = {
    "version": (w.SensHeader(version=3), "version 4"),
    "colour kind": (w.SensHeader(colour_kind=7), "stores colour in kind 7.*export"),
    "depth kind": (w.SensHeader(depth_kind=2), "stores depth in kind 2.*export"),
    "no pixels": (w.SensHeader(depth_size=(0, 48)), "0x48"),
    "absurd size": (w.SensHeader(depth_size=(2**31, 2**31)), "2147483648x2147483648"),
    "depth shift": (w.SensHeader(shift=float("nan")), "depth shift nan"),
    "too many frames for the file": (w.SensHeader(frames=2**60), "frames in a file too short"),
    "one more frame than there is": (w.SensHeader(frames=4), "corrupt.*ends too early"),
    "no frames": (w.SensHeader(frames=0), "0 usable scan"),
    "NaN in the camera": (w.SensHeader(depth_matrix=np.full((4, 4), np.nan)), "NaN"),
    "no rigid extrinsics": (w.SensHeader(reference_T_depth=np.zeros((4, 4))), "depth extrinsics"),
    "NaN extrinsics": (w.SensHeader(reference_T_depth=np.full((4, 4), np.nan)), "extrinsics"),
}


@pytest.mark.parametrize("case", HEADERS)
def test_header(case: str, tmp_path: Path) -> None:
    header, expected = HEADERS[case]
    message = message_of(w.sens_bytes(header=header), tmp_path)
    assert "scene.sens" in message and re.search(expected, message)


def test_long_recordings_have_poses_but_are_too_many_scans(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(assembly, "MAX_SCANS", 4)
    content = w.sens_bytes(w.samples(5, colour_size=(16, 12), depth_size=(16, 12)))
    assert "5 scans: pick a subset of 5 to 20" in message_of(content, tmp_path)
    assert len(scans.truth(tmp_path / "scene.sens")) == 5


def test_depth_of_another_size_than_the_header_says(tmp_path: Path) -> None:
    header = w.SensHeader(depth_size=(64, 47))
    assert "64x47 values" in message_of(w.sens_bytes(header=header), tmp_path)


def test_colour_of_another_size_than_the_header_says(tmp_path: Path) -> None:
    made = w.samples(3)
    made[1] = w.Sample(w.colour_ramp(32, 24), made[1].raw)
    message = message_of(w.sens_bytes(made), tmp_path)
    assert "colour of frame-000001" in message and "32x24 instead of 64x48" in message


def test_a_frame_without_colour(tmp_path: Path) -> None:
    content = bytearray(GOOD)
    struct.pack_into("<Q", content, HEADER_BYTES + 80, 0)
    assert re.search(
        "frame 0 of .* lacks its colour or depth", message_of(bytes(content), tmp_path)
    )


def test_a_bomb_does_not_inflate(tmp_path: Path) -> None:
    bomb = zlib.compress(bytes(40 << 20), 9)
    colour = w.encode(w.samples()[0].colour)
    frame = w.sens_bytes()[HEADER_BYTES : HEADER_BYTES + 64]
    frame += struct.pack("<4Q", 0, 0, len(colour), len(bomb)) + colour + bomb
    path = w.put(tmp_path / "scene.sens", w.sens_bytes()[:HEADER_BYTES] + 3 * frame)

    tracemalloc.start()
    try:
        with pytest.raises(ScanError, match="does not hold 64x48 values"):
            scans.load(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()

    assert peak < 8 << 20


def test_lost_tracking_and_broken_poses(tmp_path: Path) -> None:
    made = w.samples()
    made[1] = w.Sample(made[1].colour, made[1].raw, np.full((4, 4), -np.inf))
    path = w.put(tmp_path / "scene.sens", w.sens_bytes(made))
    assert list(scans.truth(path)) == ["frame-000000", "frame-000002"]
    made[1] = w.Sample(made[1].colour, made[1].raw, np.zeros((4, 4)))
    w.put(path, w.sens_bytes(made))
    with pytest.raises(ScanError, match=r"pose of frame-000001 in .*scene\.sens"):
        scans.truth(path)
