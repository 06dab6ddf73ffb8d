"""Matterport3D, a house after undistortion: ``undistorted_*_images/`` and a ``.conf`` file.

The file has a line ``intrinsics_matrix`` of nine numbers for the ``scan DEPTH COLOUR`` lines below
it, each with a camera-to-world matrix of 16. Images count from the bottom there: cameras look
along -z with y up, and the principal point's height is measured from the lowest row of pixels
(data_organization.md of the data set; RGBDCamera::ReadMatterportFile of its GAPS tools).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fewview.errors import ScanError
from fewview.scans import cameras, poses
from fewview.scans.cameras import Pinhole
from fewview.scans.depth_unit import DepthUnit
from fewview.scans.files import numbers, table
from fewview.scans.images import ColourFile, DepthFile
from fewview.scans.reader import Listing, Shot
from fewview.types import Array

NAME = "matterport"
LAYOUT = (
    "undistorted_color_images/ + undistorted_depth_images/ + "
    "undistorted_camera_parameters/HOUSE.conf (Matterport3D)"
)

SIZE = (1280, 1024)
"""Width and height of all images that the parameters are for."""

_CAMERAS, _COLOUR, _DEPTH = (
    f"undistorted_{part}" for part in ("camera_parameters", "color_images", "depth_images")
)
_GL_T_CV = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class _Entry:
    """A ``scan`` line: two file names, the camera above it, 16 words of a pose."""

    depth: str
    colour: str
    camera: Pinhole
    pose: list[str]

    @property
    def name(self) -> str:
        return Path(self.colour).stem


def recognises(path: Path) -> bool:
    """Whether the three folders are there."""
    return all((path / part).is_dir() for part in (_CAMERAS, _COLOUR, _DEPTH))


def read(path: Path) -> Listing:
    """List the scans; those without both images, as in a part of a house, are left out.

    Raises:
        ScanError: half a pair, a doubled name, or no usable parameters.
    """
    entries = _entries(path)
    shots = []
    for entry in entries:
        colour, depth = path / _COLOUR / entry.colour, path / _DEPTH / entry.depth
        for here, there in ((colour, depth), (depth, colour)):
            if here.is_file() and not there.is_file():
                raise ScanError(f"{here} has no partner {there}: add it, or remove this file")
        if colour.is_file():
            shots.append(Shot(entry.name, ColourFile(colour), DepthFile(depth), entry.camera))
    _check_names(path, [shot.name for shot in shots])
    left_out = len(entries) - len(shots)
    note = f"{left_out} of {len(entries)} scans of the parameters have no images here"
    unit = DepthUnit(1 / 4000, "1/4000 m, as Matterport3D stores them")
    return Listing(tuple(shots), None, unit, (note,) if left_out else ())


def truth(path: Path) -> dict[str, Array]:
    """``world_T_scan`` from the ``scan`` lines.

    Raises:
        ScanError: a line is unusable.
    """
    file, found = _file(path), dict[str, Array]()
    names = {shot.name for shot in read(path).shots}
    for entry in _entries(path):
        label = f"the pose of {entry.name} in {file}"
        world_T_gl = poses.rigid(numbers(" ".join(entry.pose), label).reshape(4, 4), label)
        if world_T_gl is not None and entry.name in names:
            found[entry.name] = world_T_gl @ _GL_T_CV
    return found


def _file(path: Path) -> Path:
    found = sorted((path / _CAMERAS).glob("*.conf"))
    if len(found) != 1:
        raise ScanError(
            f"{path / _CAMERAS} holds {len(found)} .conf files: put the one of this house there"
        )
    return found[0]


def _entries(path: Path) -> list[_Entry]:
    file = _file(path)
    camera: Pinhole | None = None
    found = []
    for words in table(file):
        if words[0] == "intrinsics_matrix":
            camera = _camera(words[1:], file)
        elif words[0] == "scan":
            if camera is None or len(words) != 19:
                raise ScanError(
                    f"{file}: each scan needs an intrinsics_matrix line above it and is "
                    "'scan DEPTH COLOUR' with 16 numbers: download the file again"
                )
            found.append(_Entry(words[1], words[2], camera, words[3:]))
    return found


def _camera(words: list[str], file: Path) -> Pinhole:
    values = numbers(" ".join(words), str(file))
    if len(values) != 9:
        raise ScanError(f"{file}: an intrinsics_matrix has 9 numbers, not {len(values)}")
    upwards = cameras.pinhole(values.reshape(3, 3), str(file))
    return replace(upwards, cy=SIZE[1] - 1 - upwards.cy, size=SIZE)


def _check_names(path: Path, names: list[str]) -> None:
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ScanError(f"{_file(path)} lists '{twice}' twice: remove one of the lines")
