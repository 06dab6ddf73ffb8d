"""7-Scenes and 3DMatch: ``NAME.color.(jpg|png)``, ``NAME.depth.png``, ``NAME.pose.txt``.

A scan may have a camera of its own, ``NAME.intrinsics.txt``, in place of the folder's.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from fewview.scans import cameras, pairing, poses
from fewview.scans.depth_unit import MILLIMETRE, DepthUnit
from fewview.scans.notes import some
from fewview.scans.reader import Calibration, Listing, Shot
from fewview.types import Array

NAME = "7scenes"
LAYOUT = "NAME.color.jpg|png + NAME.depth.png + intrinsics.txt (7-Scenes, 3DMatch)"

_COLOUR = re.compile(r"(?P<name>.+)\.color\.(jpg|jpeg|png)", re.IGNORECASE)
_DEPTH = re.compile(r"(?P<name>.+)\.depth\.(jpg|jpeg|png)", re.IGNORECASE)
_CAMERA = re.compile(r"(?P<name>.+)\.intrinsics\.txt", re.IGNORECASE)


def recognises(path: Path) -> bool:
    """Whether any file is named like one of the images."""
    if not path.is_dir():
        return False
    names = [file.name for file in pairing.files(path)]
    return any(_COLOUR.fullmatch(name) or _DEPTH.fullmatch(name) for name in names)


def read(path: Path) -> Listing:
    """List the scans.

    Raises:
        ScanError: half a pair, a doubled name, or no usable camera file.
    """
    found = pairing.files(path)
    shots = pairing.pair(pairing.by_name(found, _COLOUR), pairing.by_name(found, _DEPTH))
    shots, notes = _with_cameras(shots, pairing.by_name(found, _CAMERA))
    unit = DepthUnit(MILLIMETRE, "millimetres, usual for 16-bit PNG")
    if all(shot.camera for shot in shots):
        return Listing(shots, None, unit, notes)
    camera, source = cameras.find_pinhole(path)
    return Listing(shots, Calibration(camera), unit, (f"intrinsics from {source.name}", *notes))


def truth(path: Path) -> dict[str, Array]:
    """``world_T_scan`` from ``NAME.pose.txt``.

    Raises:
        ScanError: a pose file is unusable.
    """
    return poses.read_poses({s.name: path / f"{s.name}.pose.txt" for s in read(path).shots})


def _with_cameras(
    shots: Iterable[Shot], files: dict[str, Path]
) -> tuple[tuple[Shot, ...], tuple[str, ...]]:
    """The shots with the cameras of their own, and notes about these files."""
    completed = tuple(
        replace(shot, camera=cameras.read_matrix(files[shot.name])) if shot.name in files else shot
        for shot in shots
    )
    own = [shot.name for shot in completed if shot.camera]
    orphans = [file.name for name, file in files.items() if name not in own]
    notes = [f"intrinsics of their own: {some(own)}"] if own else []
    if orphans:
        notes.append(f"ignored, because there is no scan of that name: {some(orphans)}")
    return completed, tuple(notes)
