"""Open3D and Redwood: ``color|image|rgb/``, ``depth/``, ``camera_intrinsic.json``."""

from __future__ import annotations

from pathlib import Path

from fewview.errors import ScanError
from fewview.scans import cameras, pairing, poses
from fewview.scans.depth_unit import MILLIMETRE, DepthUnit
from fewview.scans.images import ColourFile, DepthFile
from fewview.scans.reader import Calibration, Listing, Shot
from fewview.types import Array

NAME = "redwood"
LAYOUT = "color|image|rgb/ + depth/ + camera_intrinsic.json (Open3D, Redwood)"

_COLOUR_FOLDERS = ("color", "image", "rgb")
_TRAJECTORIES = ("trajectory.log", "odometry.log")


def recognises(path: Path) -> bool:
    """Whether there is a folder of colour and one of depth images."""
    return (path / "depth").is_dir() and any((path / c).is_dir() for c in _COLOUR_FOLDERS)


def read(path: Path) -> Listing:
    """List the scans, matched by name, or by order where no name is common to both folders.

    Raises:
        ScanError: half a pair, a doubled name, or no usable camera file.
    """
    shots, notes = _shots(path)
    camera, source = cameras.find_pinhole(path)
    unit = DepthUnit(MILLIMETRE, "millimetres, usual for 16-bit PNG")
    if camera.depth_scale:
        unit = DepthUnit(1 / camera.depth_scale, f"depth_scale in {source.name}")
    return Listing(shots, Calibration(camera), unit, (f"intrinsics from {source.name}", *notes))


def truth(path: Path) -> dict[str, Array]:
    """``world_T_scan`` from ``trajectory.log`` or ``odometry.log``, one pose a scan in order.

    Raises:
        ScanError: the file is unusable or has another number of poses.
    """
    for log in (path / name for name in _TRAJECTORIES):
        if log.is_file():
            shots, found = _shots(path)[0], poses.read_log(log)
            if len(found) != len(shots):
                raise ScanError(
                    f"{log} holds {len(found)} poses for {len(shots)} scans: keep one a scan"
                )
            named = zip((shot.name for shot in shots), found, strict=True)
            return {name: matrix for name, matrix in named if matrix is not None}
    return {}


def _shots(path: Path) -> tuple[tuple[Shot, ...], tuple[str, ...]]:
    folder = next(path / name for name in _COLOUR_FOLDERS if (path / name).is_dir())
    colour = pairing.by_name(pairing.files(folder))
    depth = pairing.by_name(pairing.files(path / "depth"))
    if colour.keys() & depth.keys() or len(colour) != len(depth):
        return pairing.pair(colour, depth), ()
    both = zip(colour.items(), depth.values(), strict=True)
    shots = tuple(Shot(name, ColourFile(c), DepthFile(d)) for (name, c), d in both)
    return shots, (f"{folder.name}/ and depth/ have no common names: matched by their order",)
