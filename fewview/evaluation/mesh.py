"""Accuracy and completeness of a mesh against the true one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from fewview.types import Array, IntArray


@dataclass(frozen=True)
class MeshErrors:
    """How two surfaces differ.

    Attributes:
        accuracy: share of the estimate within the threshold of the truth.
        completeness: share of the truth within the threshold of the estimate.
        accuracy_m: median distance from the estimate to the truth.
        completeness_m: median distance from the truth to the estimate.
    """

    accuracy: float
    completeness: float
    accuracy_m: float
    completeness_m: float

    @property
    def f_score(self) -> float:
        """Harmonic mean of accuracy and completeness."""
        total = self.accuracy + self.completeness
        return 2.0 * self.accuracy * self.completeness / total if total else 0.0


def sample_surface(vertices: Array, faces: IntArray, count: int, rng: np.random.Generator) -> Array:
    """``count`` points spread evenly by area over the (m, 3) triangles of (n, 3) vertices."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    chosen = rng.choice(len(faces), size=count, p=area / area.sum())
    u, v = rng.random((2, count, 1))
    outside = u + v > 1.0
    u, v = np.where(outside, 1.0 - u, u), np.where(outside, 1.0 - v, v)
    a, b, c = a[chosen], b[chosen], c[chosen]
    return np.asarray(a + u * (b - a) + v * (c - a))


def mesh_errors(
    estimate: Array, truth: Array, threshold_m: float = 0.05, max_queries: int = 30_000
) -> MeshErrors:
    """Compare (n, 3) and (m, 3) points sampled on two surfaces in one frame, metres.

    Distances are between samples, so sample far denser than ``threshold_m``. Of each surface the
    first ``max_queries`` points look for their nearest among all of the other's: samples are in
    random order (`sample_surface`).

    Raises:
        ValueError: one of the surfaces has no points.
    """
    if not len(estimate) or not len(truth):
        raise ValueError("both surfaces need points")
    to_truth, _ = KDTree(truth).query(estimate[:max_queries])
    to_estimate, _ = KDTree(estimate).query(truth[:max_queries])
    return MeshErrors(
        float((to_truth <= threshold_m).mean()),
        float((to_estimate <= threshold_m).mean()),
        float(np.median(to_truth)),
        float(np.median(to_estimate)),
    )
