"""ScanNet ``.sens`` files, version 4, read within bounds.

Nothing in the file is believed: every count and size is checked against what is left of the file
and against limits before anything is read or allocated.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from fewview.errors import ScanError
from fewview.scans import cameras, images, poses, scannet
from fewview.scans.depth_unit import DepthUnit
from fewview.scans.images import Size
from fewview.scans.reader import Calibration, Listing, Shot
from fewview.scans.sens_images import SensColour, SensDepth, corrupt, exactly, opened
from fewview.types import Array

NAME = "sens"
LAYOUT = "FILE.sens (ScanNet)"

_VERSION = 4
_COLOUR_KINDS = {1: "PNG", 2: "JPEG"}
_DEPTH_RAW, _DEPTH_ZLIB = 0, 1
_MAX_NAME_BYTES = 4096
_MAX_IMAGE_BYTES = 64 << 20
_HEADER = struct.Struct("<64f2i4IfQ")
_FRAME = struct.Struct("<16f4Q")


@dataclass(frozen=True, eq=False)
class _Frame:
    """A frame's pose, and offset and length of its two images."""

    world_T_reference: Array
    colour: tuple[int, int]
    depth: tuple[int, int]


@dataclass(frozen=True, eq=False)
class _Sens:
    """The index of a file."""

    calibration: Calibration
    reference_T_depth: Array
    depth_shift: float
    shots: tuple[Shot, ...]
    world_T_reference: tuple[Array, ...]


def recognises(path: Path) -> bool:
    """Whether ``path`` is such a file or a folder that holds exactly one."""
    return _sens_file(path) is not None


def read(path: Path) -> Listing:
    """List the frames.

    Raises:
        ScanError: not version 4, truncated, corrupt, or with too many frames.
    """
    sens = _index(path)
    unit = DepthUnit(1.0 / sens.depth_shift, f"depth shift {sens.depth_shift:g} in the header")
    return Listing(sens.shots, sens.calibration, unit)


def truth(path: Path) -> dict[str, Array]:
    """``world_T_scan`` of the depth camera, for frames with a finite pose.

    Raises:
        ScanError: see `read`; or a pose is no rigid motion.
    """
    sens = _index(path)
    found: dict[str, Array] = {}
    for shot, matrix in zip(sens.shots, sens.world_T_reference, strict=True):
        world_T_reference = poses.rigid(matrix, f"the pose of {shot.name} in {path}")
        if world_T_reference is not None:
            found[shot.name] = world_T_reference @ sens.reference_T_depth
    return found


def _sens_file(path: Path) -> Path | None:
    if path.is_file():
        return path if path.suffix.lower() == ".sens" else None
    inside = [p for p in path.glob("*.sens") if p.is_file()]
    return inside[0] if len(inside) == 1 else None


def _index(path: Path) -> _Sens:
    file = _sens_file(path) or path
    with opened(file) as stream:
        _check_version(stream, file)
        values = _HEADER.unpack(exactly(stream, _HEADER.size, file))
        matrices = np.array(values[:64], dtype=np.float64).reshape(4, 4, 4)
        colour_kind, depth_kind, *sizes, shift, count = values[64:]
        colour_size, depth_size = (sizes[0], sizes[1]), (sizes[2], sizes[3])
        _check_header(file, colour_kind, depth_kind, colour_size, depth_size, shift)
        _check_frame_count(stream, count, file)
        calibration, reference_T_depth = _calibration(matrices, file)
        frames = [_frame(stream, file, f"frame {i} of {file}") for i in range(count)]
    shots = tuple(
        _shot(f"frame-{i:06d}", file, frame, colour_size, depth_size, depth_kind == _DEPTH_ZLIB)
        for i, frame in enumerate(frames)
    )
    world_T_reference = tuple(frame.world_T_reference for frame in frames)
    return _Sens(calibration, reference_T_depth, shift, shots, world_T_reference)


def _shot(
    name: str, path: Path, frame: _Frame, colour_size: Size, depth_size: Size, deflated: bool
) -> Shot:
    return Shot(
        name,
        SensColour(path, f"colour of {name} in {path}", *frame.colour, colour_size),
        SensDepth(path, f"depth of {name} in {path}", *frame.depth, depth_size, deflated),
    )


def _check_version(stream: IO[bytes], path: Path) -> None:
    version, name_length = struct.unpack("<IQ", exactly(stream, 12, path))
    if version != _VERSION:
        raise ScanError(f"{path} is not a .sens file of version {_VERSION}: export it again")
    if name_length > _MAX_NAME_BYTES:
        raise ScanError(corrupt(path, f"sensor name of {name_length} bytes"))
    exactly(stream, name_length, path)


def _check_header(
    path: Path, colour_kind: int, depth_kind: int, colour: Size, depth: Size, shift: float
) -> None:
    if colour_kind not in _COLOUR_KINDS:
        raise ScanError(
            f"{path} stores colour in kind {colour_kind}: only PNG (1) and JPEG (2) are read; "
            "export the frames to a folder"
        )
    if depth_kind not in (_DEPTH_RAW, _DEPTH_ZLIB):
        raise ScanError(
            f"{path} stores depth in kind {depth_kind}: only raw (0) and zlib (1) are read; "
            "export the frames to a folder"
        )
    images.check_size(*colour, f"the header of {path} (colour)")
    images.check_size(*depth, f"the header of {path} (depth)")
    if not 1.0 <= shift <= 1e6:
        raise ScanError(corrupt(path, f"depth shift {shift:g}"))


def _check_frame_count(stream: IO[bytes], count: int, path: Path) -> None:
    if count * _FRAME.size > _remaining(stream):
        raise ScanError(corrupt(path, f"{count} frames in a file too short for them"))


def _calibration(matrices: Array, path: Path) -> tuple[Calibration, Array]:
    """The header's four matrices: intrinsic and extrinsic of colour, then of depth."""
    colour = cameras.pinhole(matrices[0], f"colour intrinsics of {path}")
    depth = cameras.pinhole(matrices[2], f"depth intrinsics of {path}")
    reference_T_colour = poses.rigid(matrices[1], f"colour extrinsics of {path}")
    reference_T_depth = poses.rigid(matrices[3], f"depth extrinsics of {path}")
    if reference_T_colour is None or reference_T_depth is None:
        raise ScanError(corrupt(path, "extrinsics with NaN or inf"))
    both = scannet.calibration(depth, colour, reference_T_depth, reference_T_colour)
    return both, reference_T_depth


def _frame(stream: IO[bytes], path: Path, label: str) -> _Frame:
    """Index the next frame and skip over its images."""
    values = _FRAME.unpack(exactly(stream, _FRAME.size, path))
    pose = np.array(values[:16], dtype=np.float64).reshape(4, 4)
    colour_length, depth_length = values[18], values[19]
    start = stream.tell()
    if min(colour_length, depth_length) == 0:
        raise ScanError(f"{label} lacks its colour or depth image: export the others to a folder")
    too_long = max(colour_length, depth_length) > _MAX_IMAGE_BYTES
    if too_long or colour_length + depth_length > _remaining(stream):
        raise ScanError(corrupt(path, f"{label} is longer than what is left of the file"))
    stream.seek(start + colour_length + depth_length)
    return _Frame(pose, (start, colour_length), (start + colour_length, depth_length))


def _remaining(stream: IO[bytes]) -> int:
    here = stream.tell()
    end = stream.seek(0, 2)
    stream.seek(here)
    return end - here
