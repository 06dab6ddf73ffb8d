"""7-Scenes and 3DMatch: ``NAME.color.(jpg|png)``, ``NAME.depth.png``, ``NAME.pose.txt``."""

from __future__ import annotations

import re
from pathlib import Path

from fewview.scans import cameras, pairing, poses
from fewview.scans.depth_unit import MILLIMETRE, DepthUnit
from fewview.scans.reader import Calibration, Listing
from fewview.types import Array

NAME = "7scenes"
LAYOUT = "NAME.color.jpg|png + NAME.depth.png + intrinsics.txt (7-Scenes, 3DMatch)"

_COLOUR = re.compile(r"(?P<name>.+)\.color\.(jpg|jpeg|png)", re.IGNORECASE)
_DEPTH = re.compile(r"(?P<name>.+)\.depth\.(jpg|jpeg|png)", re.IGNORECASE)


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
    camera, source = cameras.find_pinhole(path)
    unit = DepthUnit(MILLIMETRE, "millimetres, usual for 16-bit PNG")
    return Listing(shots, Calibration(camera), unit, (f"intrinsics from {source.name}",))


def truth(path: Path) -> dict[str, Array]:
    """``world_T_scan`` from ``NAME.pose.txt``.

    Raises:
        ScanError: a pose file is unusable.
    """
    return poses.read_poses({s.name: path / f"{s.name}.pose.txt" for s in read(path).shots})
