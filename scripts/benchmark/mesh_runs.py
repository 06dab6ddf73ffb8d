"""Meshes of placed scans against the true surface of the scene, kept on disk."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmark.catalogue import key_of
from benchmark.scenes import Scene
from benchmark.store import Record, Store
from benchmark.tasks import SetTask
from fewview.config import FusionConfig
from fewview.evaluation.gauge import align
from fewview.evaluation.mesh import MeshErrors, mesh_errors, sample_surface
from fewview.fusion import fuse
from fewview.types import Array, ColouredMesh

SAMPLES = 200_000
"""Points on either surface: a room of 100 square metres has one every 2 cm."""
THRESHOLD_M = 0.05


@dataclass(frozen=True)
class MeshTask:
    """The mesh of a set, fused with a method's poses, or with the true ones.

    The same fusion for every method, so that only poses differ. Scans outside the largest
    component are not fused.

    Attributes:
        placed: the set, answered.
        true_poses: use the scene's own poses: what fusion alone costs.
    """

    placed: SetTask
    true_poses: bool = False

    @property
    def store(self) -> Store:
        """Where answers are kept."""
        return self.placed.store

    @property
    def path(self) -> Path:
        """Of the record, beside that of the set."""
        own = key_of("true" if self.true_poses else "mesh", [SAMPLES], ["fewview.fusion", __name__])
        return self.placed.path.with_name(f"{self.placed.path.stem}-{own}.pkl")

    @property
    def group(self) -> tuple[Hashable, ...]:
        """A set each."""
        return self.placed.path, self.true_poses

    def run(self) -> Record[MeshErrors | None]:
        """Fuse, move into the frame of the truth, compare; None without two scans together."""
        scene, names = self.placed.scene, self.placed.names
        posed = true_poses(scene, names) if self.true_poses else self._gauged()
        if len(posed) < 2:
            return Record(None, {})
        frames = ((scene.load(name), pose) for name, pose in posed.items())
        return Record(compared(fuse(frames, FusionConfig()), scene.mesh()), {})

    def _gauged(self) -> dict[str, Array]:
        poses = zip(self.placed.names, self.placed.largest(), strict=True)
        found = {name: pose for name, pose in poses if pose is not None}
        if len(found) < 2:
            return {}
        truth = np.stack([self.placed.scene.truth[name] for name in found])
        truth_T_world = align(truth, np.stack(list(found.values())))
        return {name: truth_T_world @ pose for name, pose in found.items()}


def true_poses(scene: Scene, names: tuple[str, ...]) -> dict[str, Array]:
    """World_T_scan of the truth, by name."""
    return {name: scene.truth[name] for name in names}


def compared(estimate: ColouredMesh, truth: ColouredMesh | None) -> MeshErrors | None:
    """Errors between two surfaces; None where one has no faces."""
    if truth is None or not len(estimate.faces) or not len(truth.faces):
        return None
    clouds = [
        sample_surface(mesh.vertices, mesh.faces, SAMPLES, np.random.default_rng(side))
        for side, mesh in enumerate((estimate, truth))
    ]
    return mesh_errors(clouds[0], clouds[1], THRESHOLD_M)
