"""Scenes with ground truth in the 7-Scenes layout, and the folders that methods are given.

Read here and not by fewview's readers: the yardstick shares no code with what it measures.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fewview.evaluation.metrics import orthonormal
from fewview.geometry import camera, se3
from fewview.types import Array, Frame, Intrinsics

COLOUR = (".color.jpg", ".color.png")


@dataclass(frozen=True)
class Scene:
    """A folder of frames ``NAME.color.(jpg|png)``, ``NAME.depth.png``, ``NAME.pose.txt``."""

    folder: Path

    @property
    def name(self) -> str:
        """The folder's own name."""
        return self.folder.name

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Scan names in order."""
        return tuple(sorted(p.name.split(".")[0] for p in self.folder.glob("*.depth.png")))

    @cached_property
    def truth(self) -> dict[str, Array]:
        """(4, 4) world_T_scan by name."""
        paths = {name: self.folder / f"{name}.pose.txt" for name in self.names}
        return {name: orthonormal(np.loadtxt(path)) for name, path in paths.items()}

    def load(self, name: str) -> Frame:
        """Read one frame; depth is 16-bit millimetres, 0 and 65535 mean nothing measured."""
        colour = cv2.cvtColor(_read(self._colour(name)), cv2.COLOR_BGR2RGB)
        raw = _read(self.folder / f"{name}.depth.png")
        depth = np.where(raw == 65535, 0, raw).astype(np.float32) / np.float32(1000.0)
        return Frame(colour, depth, self.intrinsics(name))

    def intrinsics(self, name: str) -> Intrinsics:
        """The frame's own camera when it has one, else the folder's."""
        own = self.folder / f"{name}.intrinsics.txt"
        matrix = np.loadtxt(own if own.is_file() else self.folder / "intrinsics.txt")
        height, width = _read(self.folder / f"{name}.depth.png").shape
        fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
        return Intrinsics(width, height, float(fx), float(fy), float(cx), float(cy))

    def cloud(self, name: str) -> Array:
        """(n, 3) measured points in the scan's frame, metres."""
        frame = self.load(name)
        points = camera.backproject(frame.depth, frame.intrinsics)
        return points[frame.depth > 0].astype(np.float64)

    def write(self, names: Sequence[str], turns: Mapping[str, int], out: Path) -> None:
        """Put frames into ``out`` without their poses, some of them in quarter turns.

        Frames left as they are keep the bytes of their files. Turned ones get an
        ``NAME.intrinsics.txt`` of their own.
        """
        shutil.copy(self.folder / "intrinsics.txt", out)
        for name in names:
            if turns.get(name, 0):
                write_frame(turned(self.load(name), turns[name]), out, name)
            else:
                shutil.copy(self._colour(name), out)
                shutil.copy(self.folder / f"{name}.depth.png", out)

    def turned_truth(self, names: Sequence[str], turns: Mapping[str, int]) -> dict[str, Array]:
        """The true poses of the frames as `write` leaves them."""
        return {
            name: self.truth[name] @ se3.inverse(turned_T_camera(turns.get(name, 0)))
            for name in names
        }

    def _colour(self, name: str) -> Path:
        return next(p for end in COLOUR if (p := self.folder / f"{name}{end}").is_file())


def turned(frame: Frame, turns: int) -> Frame:
    """The frame with its images turned by ``turns`` x 90 degrees counter-clockwise."""
    camera = frame.intrinsics
    for _ in range(turns % 4):
        camera = camera.quarter_turned()
    colour, depth = np.rot90(frame.colour, turns).copy(), np.rot90(frame.depth, turns).copy()
    return Frame(colour, depth, camera)


def turned_T_camera(turns: int) -> Array:
    """The motion of the camera frame that goes with `turned`."""
    quarter = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return se3.pose(np.linalg.matrix_power(quarter, turns % 4), np.zeros(3))


def write_frame(frame: Frame, out: Path, name: str) -> None:
    """Write lossless colour, depth in millimetres, and the frame's own intrinsics."""
    millimetres = np.round(frame.depth * 1000.0).astype(np.uint16)
    cv2.imwrite(str(out / f"{name}.color.png"), cv2.cvtColor(frame.colour, cv2.COLOR_RGB2BGR))
    cv2.imwrite(str(out / f"{name}.depth.png"), millimetres)
    np.savetxt(out / f"{name}.intrinsics.txt", frame.intrinsics.matrix)


def _read(path: Path) -> NDArray[Any]:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise SystemExit(f"{path}: cannot be read as an image")
    return np.asarray(image)
