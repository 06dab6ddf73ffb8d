"""Colour brought into the depth camera, and the lazily loaded frames made that way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fewview.errors import ScanError
from fewview.geometry import camera
from fewview.scans.depth_unit import to_metres
from fewview.scans.images import StoredImage
from fewview.scans.reader import Shot
from fewview.types import Array, FloatArray, Frame, Intrinsics

_FAR_OUTSIDE = 1e5


@dataclass(frozen=True, eq=False)
class Rig:
    """The cameras of one scan.

    Attributes:
        depth: camera of the stored depth image.
        target: camera of the frame: `depth`, reduced when it is large.
        colour: camera of the stored colour image.
        colour_T_depth: (4, 4), or None when colour shows the depth camera's view already and
            differs in size at most.
    """

    depth: Intrinsics
    target: Intrinsics
    colour: Intrinsics
    colour_T_depth: Array | None


@dataclass(frozen=True, eq=False)
class StoredFrame:
    """A `FrameSource` that decodes, checks and registers one stored scan."""

    shot: Shot
    rig: Rig
    depth_unit_m: float

    def load(self) -> Frame:
        """Read the pixels.

        Raises:
            ScanError: a file is missing, corrupt, empty or of the wrong type or size.
        """
        raw = _decoded(self.shot.depth, self.rig.depth)
        depth = _reduced(to_metres(raw, self.depth_unit_m), self.rig.target)
        if not depth.any():
            raise ScanError(
                f"{self.shot.depth.label} is empty (no pixel has a depth): remove this scan"
            )
        colour = _decoded(self.shot.colour, self.rig.colour)
        return Frame(register(colour, depth, self.rig), depth, self.rig.target)


def register(colour: NDArray[np.uint8], depth: FloatArray, rig: Rig) -> NDArray[np.uint8]:
    """Resample a colour image to the pixels of a depth image.

    Pixels with depth take the colour of the point they see; pixels without take that of a point
    at infinity, so that the image has no holes. Beyond the colour image its border is repeated.

    Args:
        colour: (h, w, 3) of camera ``rig.colour``.
        depth: (H, W) metres of camera ``rig.target``, 0 unknown.
        rig: the cameras.

    Returns:
        (H, W, 3) uint8.
    """
    if rig.colour_T_depth is None:
        return _resized(colour, rig.target.width, rig.target.height)
    source = rig.colour
    shrink = rig.target.fx / source.fx
    if shrink < 0.75:
        source = source.resized(round(source.width * shrink), round(source.height * shrink))
        colour = _resized(colour, source.width, source.height)
    x, y = _projected(depth, rig.target, source, rig.colour_T_depth)
    sampled = cv2.remap(colour, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(sampled, dtype=np.uint8)


def _projected(
    depth: FloatArray, target: Intrinsics, source: Intrinsics, source_T_target: Array
) -> tuple[FloatArray, FloatArray]:
    """Where the pixels of the target lie in the source: (H, W) columns and rows."""
    known = depth > 0
    rays = camera.backproject(np.where(known, depth, np.float32(1.0)), target)
    turned = rays.astype(np.float64) @ source_T_target[:3, :3].T
    pixels, _ = camera.project(turned + known[..., None] * source_T_target[:3, 3], source)
    bounded = np.clip(pixels, -_FAR_OUTSIDE, _FAR_OUTSIDE).astype(np.float32)
    return bounded[..., 0], bounded[..., 1]


def _decoded(image: StoredImage, expected: Intrinsics) -> NDArray[Any]:
    pixels = image.decode()
    height, width = pixels.shape[:2]
    if (width, height) != (expected.width, expected.height):
        raise ScanError(
            f"{image.label} is {width}x{height} instead of {expected.width}x{expected.height}: "
            "replace it by an image of the size of the others"
        )
    return pixels


def _reduced(depth: FloatArray, target: Intrinsics) -> FloatArray:
    if depth.shape == (target.height, target.width):
        return depth
    size = (target.width, target.height)
    return np.asarray(cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST_EXACT), np.float32)


def _resized(colour: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    if colour.shape[:2] == (height, width):
        return colour
    method = cv2.INTER_AREA if width < colour.shape[1] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(colour, (width, height), interpolation=method), dtype=np.uint8)
