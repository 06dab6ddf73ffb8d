"""What was recognised in a folder of scans, without running anything on it."""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fewview.errors import ScanError
from fewview.scans.assembly import Assembly, assemble
from fewview.scans.images import Size
from fewview.scans.notes import some
from fewview.scans.reader import Reader
from fewview.scans.registration import Rig
from fewview.scans.registry import find_reader
from fewview.types import Intrinsics, Scan

_SPARSE = 0.2
_FAR_M = 6.0


@dataclass(frozen=True)
class ScanRange:
    """The depth of one scan.

    Attributes:
        name: the scan.
        valid_share: 0..1, share of the pixels that have a depth.
        depth_m: 5, 50 and 95 percent quantiles of the depth, metres.
    """

    name: str
    valid_share: float
    depth_m: tuple[float, float, float]


@dataclass(frozen=True)
class Inspection:
    """The findings.

    Attributes:
        path: what was inspected.
        format: the layout's name.
        scans: one per scan, in the order of their names.
        colour_size: width and height of the stored colour images, those of most scans.
        depth_size: width and height of the stored depth images, those of most scans.
        intrinsics: camera of the frames, colour and depth, that of most scans.
        cameras: number of different cameras.
        depth_unit_m: metres per raw depth value.
        depth_unit_reason: how that was determined.
        poses: number of scans that have a ground-truth pose.
        notes: what was assumed, beside the depth unit.
        warnings: what may spoil the result.
    """

    path: str
    format: str
    scans: tuple[ScanRange, ...]
    colour_size: Size
    depth_size: Size
    intrinsics: Intrinsics
    cameras: int
    depth_unit_m: float
    depth_unit_reason: str
    poses: int
    notes: tuple[str, ...]
    warnings: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """The same as values that JSON knows."""
        return asdict(self)

    def text(self) -> str:
        """A report for people, several lines."""
        camera = self.intrinsics
        lines = [
            f"{self.path}: {len(self.scans)} scans, layout {self.format}",
            f"  colour      {self.colour_size[0]} x {self.colour_size[1]}",
            f"  depth       {self.depth_size[0]} x {self.depth_size[1]}",
            f"  camera      {camera.width} x {camera.height}, fx {camera.fx:.2f} fy "
            f"{camera.fy:.2f} cx {camera.cx:.2f} cy {camera.cy:.2f}"
            f"{f' (the commonest of {self.cameras} cameras)' if self.cameras > 1 else ''}",
            f"  depth unit  {self.depth_unit_m:g} m ({self.depth_unit_reason})",
            f"  poses       {self.poses or 'none'}{' (for evaluate only)' if self.poses else ''}",
            *(f"  note        {note}" for note in self.notes),
            *(f"  warning     {warning}" for warning in self.warnings),
        ]
        width = max(len("scan"), *(len(scan.name) for scan in self.scans))
        lines.append(f"  {'scan':<{width}}  valid   depth 5 / 50 / 95 % [m]")
        for scan in self.scans:
            low, middle, high = scan.depth_m
            lines.append(
                f"  {scan.name:<{width}}  {scan.valid_share:5.1%}   "
                f"{low:.2f} / {middle:.2f} / {high:.2f}"
            )
        return "\n".join(lines)


def inspect(path: str | os.PathLike[str], depth_unit_m: float | None = None) -> Inspection:
    """Recognise ``path`` and look at every image once.

    Raises:
        ScanError: as `fewview.scans.load`, and for unusable pixels.
    """
    reader, where = find_reader(path)
    assembly = assemble(reader.NAME, str(where), reader.read(where), depth_unit_m)
    ranges = tuple(_range(scan) for scan in assembly.scans.scans)
    poses, warnings = _count_poses(reader, where)
    warnings = [*_warnings(assembly, ranges), *warnings]
    rig, cameras = _commonest(assembly)
    return Inspection(
        path=str(where),
        format=reader.NAME,
        scans=ranges,
        colour_size=(rig.colour.width, rig.colour.height),
        depth_size=(rig.depth.width, rig.depth.height),
        intrinsics=rig.target,
        cameras=cameras,
        depth_unit_m=assembly.unit.metres,
        depth_unit_reason=assembly.unit.reason,
        poses=poses,
        notes=assembly.notes,
        warnings=tuple(warnings),
    )


def _commonest(assembly: Assembly) -> tuple[Rig, int]:
    """The rig with the cameras of most scans, and the number of different cameras."""
    cameras = [(rig.depth, rig.colour) for rig in assembly.rigs]
    counts = Counter(cameras)
    return assembly.rigs[cameras.index(counts.most_common(1)[0][0])], len(counts)


def _range(scan: Scan) -> ScanRange:
    depth = scan.load().depth
    measured = depth[depth > 0]
    low, middle, high = (float(q) for q in np.quantile(measured, (0.05, 0.5, 0.95)))
    return ScanRange(scan.name, measured.size / depth.size, (low, middle, high))


def _count_poses(reader: Reader, path: Path) -> tuple[int, list[str]]:
    try:
        return len(reader.truth(path)), []
    except ScanError as error:
        return 0, [f"poses cannot be read: {error}"]


def _warnings(assembly: Assembly, ranges: tuple[ScanRange, ...]) -> list[str]:
    found = [assembly.unit.warning] if assembly.unit.warning else []
    sparse = [scan.name for scan in ranges if scan.valid_share < _SPARSE]
    if sparse:
        found.append(f"under {_SPARSE:.0%} of the pixels have a depth in {some(sparse)}")
    far = [scan.name for scan in ranges if scan.depth_m[1] > _FAR_M]
    if far:
        found.append(f"most depths are beyond {_FAR_M:g} m in {some(far)}")
    return found
