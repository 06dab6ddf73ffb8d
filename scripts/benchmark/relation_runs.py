"""Relation predictors on scan pairs whose true pose is perturbed at random, kept on disk.

The protocol is the paper's (Sec. 4, "quality of geometric relations prediction"): the true pose
of a scan pair is perturbed by up to 30 degrees and 0.5 m an axis, and the relations of 6000 random
point pairs are predicted under it.

Labels come from the scene's true mesh where it has one, as generated rooms do. Real scans have
none, so their labels come from the normals that were measured; at a tolerance of 5 degrees the
noise of those decides many of them.
"""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from benchmark.code import fingerprint
from benchmark.relations import LABEL_RULES, PREDICTORS, Predictor
from benchmark.scenes import Scene
from benchmark.store import Record, Store
from benchmark.surface_truth import Oriented, TrueMesh
from fewview.config import Config
from fewview.evaluation import relations as labelling
from fewview.evaluation.metrics import relative, rotation_error_deg
from fewview.evaluation.relations import confusion, perturbed, true_relations
from fewview.types import Array, CompletedScan, IntArray

SAMPLES = 6000
"""Point pairs of a scan pair (Sec. 3.3), drawn evenly."""
PERTURBATIONS = 3
"""Perturbed poses that a scan pair is looked at under."""
CEILING = "rules, 5 deg / 0.05 m, true pose"
"""Not a method: what the noise of the measured normals alone costs when the pose is exact."""
KEPT_SCANS = 64
"""Completed scans that a worker keeps."""


@dataclass(frozen=True)
class Labelled:
    """A scan with the truth about its surface.

    Attributes:
        scan: what predictors are given.
        truth: true position and normal of each surface point; the measured ones where nothing
            better is known.
    """

    scan: CompletedScan
    truth: Oriented


@dataclass(frozen=True)
class Judged:
    """What the predictors said about a scan pair under one perturbed pose.

    Attributes:
        perturbation_deg: rotation of the perturbation.
        counts: (4, 4) confusion counts per predictor.
    """

    perturbation_deg: float
    counts: Mapping[str, IntArray]


@dataclass(frozen=True)
class RelationTask:
    """All predictors on two scans of a scene under `PERTURBATIONS` perturbed poses."""

    store: Store
    scene: Scene
    source: str
    target: str
    seed: int

    @property
    def path(self) -> Path:
        """Where the record is."""
        name = f"{self.source}~{self.target}~{self.seed}"
        return self.store.path(self.scene.key, f"relations-{_code()}", name)

    @property
    def group(self) -> tuple[Hashable, ...]:
        """Tasks that share scans."""
        return "relations", self.scene.name

    def run(self) -> Record[list[Judged]]:
        """Judge every predictor that is built."""
        source, target = _labelled(self.scene, self.source), _labelled(self.scene, self.target)
        poses = self.scene.truth
        truth = relative(poses[self.source], poses[self.target])
        key = zlib.crc32(f"{self.scene.name} {self.source} {self.target}".encode())
        rng = np.random.default_rng([self.seed, key])
        if not (len(source.truth.points) and len(target.truth.points)):
            return Record([], {})
        found = [judge(source, target, truth, rng, PREDICTORS) for _ in range(PERTURBATIONS)]
        return Record(found, {})

    def judged(self) -> list[Judged]:
        """What was found; nothing for scans without a surface.

        Raises:
            SystemExit: a predictor broke down.
        """
        record: Record[list[Judged]] = self.store.read(self.path)
        if record.answer is None:
            raise SystemExit(f"{self.path} holds a failure, remove it to try again: {record.error}")
        return record.answer


def judge(
    source: Labelled,
    target: Labelled,
    target_T_source: Array,
    rng: np.random.Generator,
    predictors: Mapping[str, Predictor],
    samples: int = SAMPLES,
) -> Judged:
    """Perturb a pair's true pose, sample point pairs evenly and compare predictions with labels.

    Args:
        source, target: the scans.
        target_T_source: (4, 4) true pose.
        rng: draws the perturbation and the point pairs.
        predictors: by name.
        samples: number of point pairs.
    """
    pose = perturbed(target_T_source, rng)
    i = rng.integers(len(source.scan.surface.points), size=samples)
    j = rng.integers(len(target.scan.surface.points), size=samples)
    a, b = source.truth.at(i), target.truth.at(j)
    labels = true_relations(a.points, a.normals, b.points, b.normals, target_T_source)
    said = {
        name: predict(source.scan, target.scan, pose, i, j) for name, predict in predictors.items()
    }
    said[CEILING] = LABEL_RULES(source.scan, target.scan, target_T_source, i, j)
    counts = {name: confusion(labels, answer) for name, answer in said.items()}
    return Judged(float(rotation_error_deg(target_T_source, pose)), counts)


@lru_cache(KEPT_SCANS)
def _labelled(scene: Scene, name: str) -> Labelled:
    """A scan as it is before its pairs; its surface does not depend on the roll of its image."""
    from fewview.completion import complete  # loads PyTorch; stored answers are read without it

    scan = complete(name, scene.load(name), 0, Config().features, 0)
    mesh = _mesh(scene)
    measured = Oriented.of(scan)
    return Labelled(scan, mesh.behind(scan, scene.truth[name]) if mesh else measured)


@lru_cache(2)
def _mesh(scene: Scene) -> TrueMesh | None:
    mesh = scene.mesh()
    return None if mesh is None else TrueMesh(mesh)


@lru_cache(1)
def _code() -> str:
    """Fingerprint of predictors and labels."""
    digest = hashlib.sha256(Path(labelling.__file__).read_bytes()).hexdigest()[:6]
    return f"{fingerprint('benchmark.relation_runs')}-{digest}"
