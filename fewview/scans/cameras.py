"""Camera files: a 3x3 (or 4x4) matrix as text, or Open3D's ``camera_intrinsic.json``."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fewview.errors import ScanError
from fewview.scans.files import numbers, read_text
from fewview.scans.images import Size
from fewview.types import Array, Intrinsics

CAMERA_FILES = ("camera_intrinsic.json", "intrinsics.txt", "camera-intrinsics.txt")
"""Where a folder may keep its intrinsics; the first that exists is read."""

EXAMPLE = "525.0 0 319.5  0 525.0 239.5  0 0 1"
"""What such a text file looks like."""

_CENTRE_TOLERANCE = 0.15
_FOCAL_RANGE = (0.2, 10.0)


@dataclass(frozen=True)
class Pinhole:
    """A camera matrix before it is known which image it belongs to.

    Attributes:
        fx, fy, cx, cy: pixels.
        label: the file it was read from.
        size: image size, when the file says it.
        depth_scale: raw depth values per metre, when the file says it.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    label: str
    size: Size | None = None
    depth_scale: float | None = None

    def off_centre(self, size: Size) -> float:
        """Distance of the principal point from the image centre, as a share of the image side."""
        width, height = size
        return max(abs((self.cx + 0.5) / width - 0.5), abs((self.cy + 0.5) / height - 0.5))

    def is_central(self, size: Size) -> bool:
        """Whether the principal point is where it can be in an image of ``size``."""
        return self.off_centre(size) <= _CENTRE_TOLERANCE

    def for_image(self, size: Size, what: str) -> Intrinsics:
        """The camera of an image of ``size``, after a check that it can be.

        Raises:
            ScanError: the matrix belongs to an image of another size.
        """
        width, height = size
        if not self.is_central(size):
            raise ScanError(
                f"{self.label}: the principal point ({self.cx:g}, {self.cy:g}) is far from the "
                f"centre of a {width}x{height} {what} image, so these intrinsics belong to "
                f"another image size: write those of the {width}x{height} image"
            )
        low, high = (share * width for share in _FOCAL_RANGE)
        if not (low <= self.fx <= high and low <= self.fy <= high):
            raise ScanError(
                f"{self.label}: focal lengths ({self.fx:g}, {self.fy:g}) do not suit {what} "
                f"images of {width}x{height}: write them in pixels of that image"
            )
        return Intrinsics(width, height, self.fx, self.fy, self.cx, self.cy)


def find_pinhole(folder: Path) -> tuple[Pinhole, Path]:
    """Read the first of `CAMERA_FILES` that ``folder`` holds.

    Raises:
        ScanError: none is there, with an example of what to write; or the file is unusable.
    """
    for name in CAMERA_FILES:
        path = folder / name
        if path.is_file():
            return (read_json(path) if path.suffix == ".json" else read_matrix(path)), path
    raise ScanError(
        f"{folder} has no camera intrinsics: write {folder / 'intrinsics.txt'} with the 3x3 matrix "
        f"of the depth image, for example '{EXAMPLE}'"
    )


def read_matrix(path: Path) -> Pinhole:
    """A text file of 9 or 16 numbers, row by row.

    Raises:
        ScanError: see `pinhole`.
    """
    values = numbers(read_text(path), str(path))
    side = {9: 3, 16: 4}.get(len(values))
    if side is None:
        raise ScanError(
            f"{path} holds {len(values)} numbers instead of the 9 of a 3x3 matrix: write for "
            f"example '{EXAMPLE}'"
        )
    return pinhole(values.reshape(side, side), str(path))


def read_json(path: Path) -> Pinhole:
    """Open3D's ``PinholeCameraIntrinsic`` (matrix column by column), with ``depth_scale`` if any.

    Raises:
        ScanError: not such a file, or see `pinhole`.
    """
    try:
        content: Any = json.loads(read_text(path))
        values = np.array(content["intrinsic_matrix"], dtype=np.float64).reshape(3, 3)
        size = int(content["width"]), int(content["height"])
        scale = float(content["depth_scale"]) if "depth_scale" in content else None
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise ScanError(
            f"{path} is not a camera file: it needs width, height and intrinsic_matrix (nine "
            f"numbers, column by column) as Open3D writes them"
        ) from error
    if scale is not None and not 0.0 < scale < np.inf:
        raise ScanError(f"{path}: depth_scale {scale:g} must be a positive number")
    by_rows = np.array_equal(values[2], [0.0, 0.0, 1.0])
    camera = pinhole(values if by_rows else values.T, str(path))
    return replace(camera, size=size, depth_scale=scale)


def pinhole(matrix: Array, label: str) -> Pinhole:
    """Take a (3, 3) or (4, 4) calibration matrix apart.

    Raises:
        ScanError: a value is not finite, a focal length not positive, or it is no such matrix.
    """
    if not np.isfinite(matrix).all():
        raise ScanError(f"{label}: the intrinsics hold NaN or inf: write finite numbers")
    fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
    if fx <= 0 or fy <= 0:
        raise ScanError(f"{label}: focal lengths ({fx:g}, {fy:g}) must be positive numbers")
    if not np.allclose(matrix[2, :3], [0.0, 0.0, 1.0]):
        raise ScanError(
            f"{label}: the third row of a camera matrix is 0 0 1: write for example '{EXAMPLE}'"
        )
    return Pinhole(float(fx), float(fy), float(cx), float(cy), label)
