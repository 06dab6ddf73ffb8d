"""Writing frames in the 7-Scenes layout that `fewview.scans.seven_scenes` reads."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from fewview.errors import ScanError
from fewview.scans import pairing
from fewview.scans.depth_unit import MILLIMETRE
from fewview.types import Array, FloatArray, Frame, Intrinsics

_JPEG_QUALITY = 95
_LARGEST = 65534


def write(
    folder: str | os.PathLike[str],
    scans: Sequence[tuple[str, Frame]],
    truth: Mapping[str, Array] | None = None,
    colour_format: Literal["jpg", "png"] = "jpg",
) -> None:
    """Write scans; each file appears complete or not at all, files of equal name are replaced.

    Args:
        folder: created when missing; it may hold no other scans.
        scans: names and frames, all of one camera.
        truth: ``world_T_scan`` (4, 4) by scan name.
        colour_format: JPEG of quality 95, or lossless PNG.

    Raises:
        ScanError: a name cannot be a file name, the cameras differ, or the folder holds other
            scans or cannot be written.
    """
    where, poses = Path(folder), truth or {}
    intrinsics = _common_intrinsics(scans)
    files = {f"{name}.color.{colour_format}" for name, _ in scans}
    files |= {f"{name}.depth.png" for name, _ in scans} | {f"{name}.pose.txt" for name in poses}
    try:
        where.mkdir(parents=True, exist_ok=True)
        _check_others(where, files)
        for name, frame in scans:
            _write_file(where / f"{name}.color.{colour_format}", _colour(frame, colour_format))
            _write_file(where / f"{name}.depth.png", _depth(frame.depth))
        for name, world_T_scan in poses.items():
            _write_file(where / f"{name}.pose.txt", _rows(world_T_scan, ".9f"))
        _write_file(where / "intrinsics.txt", _rows(intrinsics.matrix, ".17g"))
    except OSError as error:
        raise ScanError(f"{where} cannot be written ({error.strerror}): choose another") from error


def _common_intrinsics(scans: Sequence[tuple[str, Frame]]) -> Intrinsics:
    if not scans:
        raise ScanError("there are no scans to write")
    for name, frame in scans:
        if not name or name.startswith(".") or "/" in name or "\\" in name:
            raise ScanError(f"'{name}' cannot be the name of a scan: use a plain file name")
        if frame.intrinsics != scans[0][1].intrinsics:
            raise ScanError(f"scan '{name}' has another camera than '{scans[0][0]}'")
    return scans[0][1].intrinsics


def _check_others(folder: Path, files: set[str]) -> None:
    suffixes = (
        ".color.jpg",
        ".color.jpeg",
        ".color.png",
        ".depth.png",
        ".pose.txt",
        ".intrinsics.txt",
    )
    for path in pairing.files(folder):
        if path.name.lower().endswith(suffixes) and path.name not in files:
            raise ScanError(f"{path} belongs to other scans: choose an empty folder")


def _colour(frame: Frame, colour_format: str) -> bytes:
    options = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY] if colour_format == "jpg" else []
    bgr = np.ascontiguousarray(frame.colour[..., ::-1])
    return bytes(cv2.imencode(f".{colour_format}", bgr, options)[1].tobytes())


def _depth(depth: FloatArray) -> bytes:
    values = np.rint(depth.astype(np.float64) / MILLIMETRE)
    known = np.isfinite(values) & (values > 0) & (values <= _LARGEST)
    raw = np.where(known, values, 0).astype(np.uint16)
    return bytes(cv2.imencode(".png", raw)[1].tobytes())


def _rows(matrix: Array, style: str) -> bytes:
    return "".join(" ".join(format(v, style) for v in row) + "\n" for row in matrix).encode()


def _write_file(path: Path, content: bytes) -> None:
    partial = path.with_name(f".{path.name}.partial")
    try:
        partial.write_bytes(content)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
