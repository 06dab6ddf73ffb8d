"""Cameras, images and scans as they are read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fewview.types.arrays import Array, FloatArray


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera without distortion; pixel centres at integer coordinates."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @property
    def matrix(self) -> Array:
        """The (3, 3) calibration matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def resized(self, width: int, height: int) -> Intrinsics:
        """The same camera with its image resampled to ``width`` x ``height`` pixels."""
        sx, sy = width / self.width, height / self.height
        return Intrinsics(
            width,
            height,
            self.fx * sx,
            self.fy * sy,
            (self.cx + 0.5) * sx - 0.5,
            (self.cy + 0.5) * sy - 0.5,
        )

    def quarter_turned(self) -> Intrinsics:
        """The camera of the image turned counter-clockwise by 90 degrees."""
        return Intrinsics(
            self.height, self.width, self.fy, self.fx, self.cy, self.width - 1 - self.cx
        )


@dataclass(frozen=True)
class Frame:
    """The pixels of one scan, colour and depth seen by one camera.

    Attributes:
        colour: (H, W, 3) uint8, RGB.
        depth: (H, W) float32, metres along z; 0 where nothing was measured.
        intrinsics: the camera of both images.
    """

    colour: NDArray[np.uint8]
    depth: FloatArray
    intrinsics: Intrinsics


class FrameSource(Protocol):
    """Where the pixels of a scan come from; they are read when asked for, not before."""

    def load(self) -> Frame:
        """Read the pixels.

        Raises:
            ScanError: a file is missing, corrupt, empty or of the wrong type or size.
        """


@dataclass(frozen=True)
class Scan:
    """One RGB-D scan: a name, a camera, and pixels that are loaded on demand."""

    name: str
    intrinsics: Intrinsics
    source: FrameSource

    def load(self) -> Frame:
        """Read the pixels (see `FrameSource.load`)."""
        return self.source.load()


@dataclass(frozen=True)
class ScanSet:
    """What a reader recognised in a folder. Ground-truth poses are deliberately not part of it.

    Attributes:
        format: the layout's name, for example ``"7scenes"``.
        scans: in the order of their names.
        depth_unit_m: metres per raw depth value.
        notes: what was assumed or looked odd, one line each.
    """

    format: str
    scans: tuple[Scan, ...]
    depth_unit_m: float
    notes: tuple[str, ...] = ()
