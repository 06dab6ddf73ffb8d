"""TUM RGB-D: ``rgb.txt`` and ``depth.txt`` list images by time, ``groundtruth.txt`` the poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fewview.errors import ScanError
from fewview.scans import cameras, poses
from fewview.scans.depth_unit import DepthUnit
from fewview.scans.files import numbers, table
from fewview.scans.images import ColourFile, DepthFile
from fewview.scans.reader import Calibration, Listing, Shot
from fewview.types import Array

NAME = "tum"
LAYOUT = "rgb.txt + depth.txt + intrinsics.txt (TUM RGB-D)"

MAX_GAP_S = 0.02
"""Images and poses farther apart in time do not belong together."""

_UNIT = DepthUnit(1 / 5000, "1/5000 m, as TUM RGB-D stores them")


def recognises(path: Path) -> bool:
    """Whether one of the two lists is there."""
    return (path / "rgb.txt").is_file() or (path / "depth.txt").is_file()


def read(path: Path) -> Listing:
    """List the scans; the two images are registered with each other by the sensor.

    Raises:
        ScanError: a list, half a pair or the camera file is missing or unusable.
    """
    matched, notes = _matched(path)
    camera, source = cameras.find_pinhole(path)
    shots = tuple(Shot(c.stem, ColourFile(c), DepthFile(d)) for c, d, _ in matched)
    unit = _UNIT
    if camera.depth_scale:
        unit = DepthUnit(1 / camera.depth_scale, f"depth_scale in {source.name}")
    return Listing(shots, Calibration(camera), unit, (f"intrinsics from {source.name}", *notes))


def truth(path: Path) -> dict[str, Array]:
    """``world_T_scan`` of the depth images: the pose nearest in time, within `MAX_GAP_S`.

    Raises:
        ScanError: ``groundtruth.txt`` is unusable.
    """
    if not (path / "groundtruth.txt").is_file():
        return {}
    times, world_T_camera = poses.read_tum(path / "groundtruth.txt")
    if len(times) == 0:
        return {}
    found: dict[str, Array] = {}
    for colour, _, time in _matched(path)[0]:
        nearest = int(np.abs(times - time).argmin())
        if abs(times[nearest] - time) <= MAX_GAP_S:
            found[colour.stem] = world_T_camera[nearest]
    return found


def _matched(path: Path) -> tuple[list[tuple[Path, Path, float]], list[str]]:
    """(colour file, depth file, time of the depth image) in the order of time, and notes."""
    colour, depth = _listed(path / "rgb.txt"), _listed(path / "depth.txt")
    pairs = [(colour[a][1], depth[b][1], depth[b][0]) for a, b in _associate(colour, depth)]
    for files in ((c, d) for c, d, _ in pairs):
        for here, there in (files, files[::-1]):
            if here.is_file() and not there.is_file():
                raise ScanError(f"{here} has no partner {there}: add it, or remove this file")
    kept = [pair for pair in pairs if pair[0].is_file()]
    if not kept:
        raise ScanError(
            f"{path}: no colour and depth image listed in rgb.txt and depth.txt exist and lie "
            f"within {MAX_GAP_S} s of each other: check both lists"
        )
    names = [c.stem for c, _, _ in kept]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ScanError(f"{path / 'rgb.txt'} lists two images named '{twice}': remove one")
    left_out = len(colour) - len(kept)
    note = f"{left_out} of {len(colour)} entries of rgb.txt have no depth image or no file"
    return kept, [note] if left_out else []


def _listed(path: Path) -> list[tuple[float, Path]]:
    if not path.is_file():
        raise ScanError(f"{path} is missing: write a line 'timestamp file' for each image")
    rows = table(path)
    if any(len(row) != 2 for row in rows):
        raise ScanError(f"{path}: each line must be 'timestamp file'")
    times = numbers(" ".join(row[0] for row in rows), str(path))
    if not np.isfinite(times).all():
        raise ScanError(f"{path}: a timestamp is not finite: remove its line")
    return sorted((float(t), path.parent / row[1]) for t, row in zip(times, rows, strict=True))


def _associate(a: list[tuple[float, Path]], b: list[tuple[float, Path]]) -> list[tuple[int, int]]:
    """One-to-one pairs of entries within `MAX_GAP_S`, the closest taken first."""
    a_times, b_times = np.array([t for t, _ in a]), np.array([t for t, _ in b])
    first = np.searchsorted(b_times, a_times - MAX_GAP_S)
    last = np.searchsorted(b_times, a_times + MAX_GAP_S, side="right")
    options = [
        (abs(a_times[i] - b_times[j]), i, j)
        for i in range(len(a))
        for j in range(int(first[i]), int(last[i]))
    ]
    chosen: dict[int, int] = {}
    taken: set[int] = set()
    for _, i, j in sorted(options):
        if i not in chosen and j not in taken:
            chosen[i] = j
            taken.add(j)
    return sorted(chosen.items())
