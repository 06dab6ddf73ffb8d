"""Scenes with ground truth: any folder that fewview's readers know and that has true poses."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
import open3d as o3d

from fewview import scans
from fewview.evaluation.metrics import orthonormal
from fewview.evaluation.overlap import overlap_matrix
from fewview.geometry import camera, se3
from fewview.scans.assembly import assemble
from fewview.scans.files import natural_order
from fewview.scans.registry import find_reader
from fewview.types import Array, ColouredMesh, Frame, Scan

TRUE_MESH = "truth.ply"
"""Where a scene keeps its true surface, in the world of its poses."""
MAX_VIEWS = 150
"""Of longer recordings so many frames stand for all where every pair has its overlap measured."""
_GREY = 160


@dataclass(frozen=True)
class Scene:
    """Frames with true poses.

    Attributes:
        folder: a folder, or a ``.sens`` file, of a layout that `fewview.scans` reads.
        only: the frames to take; all that have a true pose when None.
    """

    folder: Path
    only: tuple[str, ...] | None = None

    @property
    def name(self) -> str:
        """The folder's own name."""
        return self.folder.stem if self.folder.is_file() else self.folder.name

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Frames that have a true pose, in natural order: that of the recording."""
        return tuple(sorted(self._poses if self.only is None else self.only, key=natural_order))

    @cached_property
    def truth(self) -> dict[str, Array]:
        """(4, 4) world_T_scan by name, rotations made exact."""
        return {name: orthonormal(self._poses[name]) for name in self.names}

    @cached_property
    def fingerprint(self) -> str:
        """Twelve hex digits over names and sizes of the folder's files, and the frames taken."""
        inside = [p for p in self.folder.rglob("*") if p.is_file() and p.name[0] != "."]
        files = sorted(inside) or [self.folder]
        told = [f"{os.path.relpath(p, self.folder)} {p.stat().st_size}" for p in files]
        return hashlib.sha256("\n".join([*told, *(self.only or ())]).encode()).hexdigest()[:12]

    @property
    def key(self) -> str:
        """A name for files that changes with the content."""
        return f"{self.name}-{self.fingerprint}"

    @cached_property
    def up(self) -> Array:
        """(3,) unit vector: the mean of the cameras' -y axes that agree within 45 degrees.

        The largest group that agrees is taken, so frames in quarter turns do not count as long as
        more are upright than are turned any other way.
        """
        axes = -np.stack([self.truth[name][:3, 1] for name in self.names])
        agree = axes @ axes.T > np.sqrt(0.5)
        mean = axes[agree[agree.sum(axis=1).argmax()]].mean(axis=0)
        return np.asarray(mean / np.linalg.norm(mean))

    def load(self, name: str) -> Frame:
        """Read one frame; no side is longer than 640 pixels.

        Raises:
            ScanError: its files are unusable.
        """
        return self._scans[name].load()

    def cloud(self, name: str) -> Array:
        """(n, 3) measured points in the scan's frame, metres."""
        frame = self.load(name)
        points = camera.backproject(frame.depth, frame.intrinsics)
        return points[frame.depth > 0].astype(np.float64)

    @property
    def has_mesh(self) -> bool:
        """Whether the true surface is known."""
        return (self.folder / TRUE_MESH).is_file()

    def mesh(self) -> ColouredMesh | None:
        """The true surface from `TRUE_MESH`, grey where it has no colours; None without one."""
        if not self.has_mesh:
            return None
        mesh = o3d.io.read_triangle_mesh(str(self.folder / TRUE_MESH))
        vertices = np.asarray(mesh.vertices, np.float64)
        colours = np.full(vertices.shape, _GREY, np.uint8)
        if mesh.has_vertex_colors():
            colours = np.rint(255.0 * np.asarray(mesh.vertex_colors)).astype(np.uint8)
        return ColouredMesh(vertices, np.asarray(mesh.triangles, np.int64), colours)

    def overlaps(self, cache: Path) -> Array:
        """(n, n) true overlaps of all pairs of `names`, kept in ``cache`` by fingerprint."""
        path = cache / "overlaps" / f"{self.key}.npy"
        if path.is_file():
            return np.asarray(np.load(path))
        poses = np.stack([self.truth[name] for name in self.names])
        matrix = overlap_matrix((self.cloud(name) for name in self.names), poses)
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(f".{os.getpid()}.npy")
        np.save(partial, matrix)
        partial.replace(path)
        return matrix

    def yaw_deg(self, a: str, b: str) -> float:
        """Angle 0..180 between two viewing directions, both seen from above along `up`."""
        across = np.eye(3) - np.outer(self.up, self.up)
        first, second = (across @ self.truth[name][:3, 2] for name in (a, b))
        turn = np.arctan2(np.linalg.norm(np.cross(first, second)), first @ second)
        return float(np.degrees(turn))

    def limited(self, seed: int) -> Scene:
        """The scene itself when it has no more than `MAX_VIEWS` frames, else so many at random."""
        if len(self.names) <= MAX_VIEWS:
            return self
        rng = np.random.default_rng([seed, len(self.names)])
        chosen = np.sort(rng.choice(len(self.names), MAX_VIEWS, replace=False))
        return replace(self, only=tuple(self.names[i] for i in chosen))

    def write(
        self, names: Sequence[str], out: Path, turns: Mapping[str, int] | None = None
    ) -> None:
        """Put frames, lossless and without their poses, into ``out`` in the 7-Scenes layout.

        Args:
            names: which frames.
            out: created when missing.
            turns: quarter turns counter-clockwise by name; the others stay as they are.
        """
        out.mkdir(parents=True, exist_ok=True)
        for name in names:
            write_frame(turned(self.load(name), (turns or {}).get(name, 0)), out, name)

    @cached_property
    def _poses(self) -> dict[str, Array]:
        return scans.truth(self.folder)

    @cached_property
    def _scans(self) -> dict[str, Scan]:
        """The frames; of longer recordings than `scans.load` takes only those that are `names`."""
        reader, where = find_reader(self.folder)
        listing = reader.read(where)
        wanted = set(self.names)
        listing = replace(listing, shots=tuple(s for s in listing.shots if s.name in wanted))
        found = assemble(reader.NAME, str(where), listing, None).scans
        return {scan.name: scan for scan in found.scans}


def turned(frame: Frame, turns: int) -> Frame:
    """The frame with its images turned by ``turns`` x 90 degrees counter-clockwise."""
    intrinsics = frame.intrinsics
    for _ in range(turns % 4):
        intrinsics = intrinsics.quarter_turned()
    colour, depth = np.rot90(frame.colour, turns).copy(), np.rot90(frame.depth, turns).copy()
    return Frame(colour, depth, intrinsics)


def turned_T_camera(turns: int) -> Array:
    """The motion of the camera frame that goes with `turned`."""
    quarter = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return se3.pose(np.linalg.matrix_power(quarter, turns % 4), np.zeros(3))


def write_frame(frame: Frame, out: Path, name: str) -> None:
    """Write colour as PNG, depth in millimetres, and the frame's own ``NAME.intrinsics.txt``."""
    millimetres = np.round(frame.depth * 1000.0).astype(np.uint16)
    cv2.imwrite(str(out / f"{name}.color.png"), cv2.cvtColor(frame.colour, cv2.COLOR_RGB2BGR))
    cv2.imwrite(str(out / f"{name}.depth.png"), millimetres)
    np.savetxt(out / f"{name}.intrinsics.txt", frame.intrinsics.matrix)


def rolled(scene: Scene, seed: int, cache: Path) -> Scene:
    """A copy of a scene of which a random half of the frames is turned by 90, 180 or 270 degrees.

    Poses, true mesh and listed sets come along. It is made once for each seed and content.

    Args:
        scene: any.
        seed: which frames, and how far.
        cache: the copy lies somewhere below it, in a folder of the scene's name.
    """
    folder = cache / f"rolled-{scene.fingerprint}-{seed}" / scene.name
    if folder.is_dir():
        return Scene(folder)
    rng = np.random.default_rng([seed, len(scene.names)])
    half = rng.permutation(len(scene.names))[: len(scene.names) // 2]
    turns = {scene.names[i]: int(rng.integers(1, 4)) for i in half}
    partial = folder.with_name(f".{folder.name}.{os.getpid()}")
    shutil.rmtree(partial, ignore_errors=True)
    scene.write(scene.names, partial, turns)
    for name, world_T_scan in scene.truth.items():
        turned_T_scan = turned_T_camera(turns.get(name, 0))
        np.savetxt(partial / f"{name}.pose.txt", world_T_scan @ se3.inverse(turned_T_scan))
    for path in (*scene.folder.glob("sets-*.txt"), *scene.folder.glob(TRUE_MESH)):
        shutil.copy(path, partial)
    partial.replace(folder)
    return Scene(folder)
