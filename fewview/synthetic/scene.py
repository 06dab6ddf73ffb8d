"""A room with scans of it and the truth about both."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fewview.ply import write_ply
from fewview.scans import writer
from fewview.synthetic.camera import ViewMode, kinect, sample_views
from fewview.synthetic.frames import render
from fewview.synthetic.room import make_room
from fewview.types import Array, ColouredMesh, Frame


@dataclass(frozen=True)
class SyntheticScene:
    """Scans of a synthetic room.

    Attributes:
        frames: the scans' pixels.
        names: one per frame.
        poses: world_T_scan (4, 4) by name; the world is z-up with the floor at 0.
        mesh: the room.
    """

    frames: tuple[Frame, ...]
    names: tuple[str, ...]
    poses: Mapping[str, Array]
    mesh: ColouredMesh


def generate(
    room_seed: int,
    scans: int,
    seed: int = 0,
    mode: ViewMode | str = ViewMode.SPREAD,
    width: int = 640,
    height: int = 480,
) -> SyntheticScene:
    """Build a room and scan it with a noisy hand-held camera.

    Args:
        room_seed: which room; see `split_seed`.
        scans: number of scans.
        seed: which views of the room, and which camera and noise.
        mode: see `sample_views`.
        width: of the images, pixels.
        height: of the images, pixels.

    Raises:
        FewviewError: the room has too few places to stand.
    """
    rng = np.random.default_rng([room_seed, seed])
    room = make_room(room_seed)
    intrinsics = kinect(width, height, rng.uniform(525.0, 585.0))
    poses = sample_views(room, scans, int(rng.integers(2**62)), mode, intrinsics)
    names = tuple(f"scan-{i:03d}" for i in range(scans))
    return SyntheticScene(
        frames=tuple(render(room, pose, intrinsics, rng) for pose in poses),
        names=names,
        poses=dict(zip(names, poses, strict=True)),
        mesh=room.mesh(),
    )


def write(folder: str | os.PathLike[str], scene: SyntheticScene) -> None:
    """Write a scene in the 7-Scenes layout, with its poses and, as ``truth.ply``, its mesh.

    Raises:
        FewviewError: the folder holds other scans or cannot be written.
    """
    writer.write(folder, list(zip(scene.names, scene.frames, strict=True)), scene.poses)
    write_ply(Path(folder) / "truth.ply", scene.mesh)
