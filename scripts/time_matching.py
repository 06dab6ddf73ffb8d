"""CPU time of the consistency matrix and the top-5 sets for a planted problem of each size.

python scripts/time_matching.py --out docs/measurements/matching.json
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from fewview.completion.xfeat import SCALES
from fewview.executor import single_threaded_libraries
from fewview.geometry import se3
from fewview.matching.consistency import CandidateMatches, consistency_matrix
from fewview.matching.spectral import top_poses
from fewview.types import Array

SIZES = (500, 1000, 2000, 4000)
REPEATS = 5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inliers", type=float, default=0.3, help="share of right matches")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    with single_threaded_libraries():
        rows = [measured(size, options.inliers) for size in SIZES]
    for row in rows:
        print(row)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps({"inliers": options.inliers, "rows": rows}, indent=1) + "\n")


def measured(size: int, inliers: float) -> dict[str, float]:
    """Median CPU milliseconds over a few runs on one thread."""
    matches = problem(size, inliers)
    matrix_ms, poses_ms = [], []
    for _ in range(REPEATS):
        start = time.process_time()
        matrix = consistency_matrix(matches)
        middle = time.process_time()
        top_poses(matches, matrix, 5)
        matrix_ms.append(1000 * (middle - start))
        poses_ms.append(1000 * (time.process_time() - middle))
    return {
        "correspondences": size,
        "matrix_ms": round(float(np.median(matrix_ms)), 1),
        "top5_ms": round(float(np.median(poses_ms)), 1),
        "filled": round(matrix.nnz / size**2, 4),
    }


def problem(size: int, inliers: float) -> CandidateMatches:
    """Matches in a 6 x 6 x 2.5 m room, a share of which agree with one pose up to 1 cm."""
    rng = np.random.default_rng(size)
    pose = se3.exp(rng.normal(size=6))
    source, normals = room_points(rng, size)
    target, target_normals = room_points(rng, size)
    right = rng.random(size) < inliers
    target[right] = se3.transform(pose, source[right]) + rng.normal(
        scale=0.01, size=(right.sum(), 3)
    )
    target_normals[right] = se3.rotate(pose, normals[right])
    index = np.arange(size)
    return CandidateMatches(
        source,
        target,
        normals,
        target_normals,
        rng.uniform(0.3, 1.0, size).astype(np.float32),
        {"xfeat": SCALES},
        np.zeros(size, dtype=np.int64),
        np.stack([index, index], axis=1),
    )


def room_points(rng: np.random.Generator, size: int) -> tuple[Array, Array]:
    points = rng.uniform(-1.0, 1.0, (size, 3)) * np.array([3.0, 3.0, 1.25])
    axis = rng.integers(0, 3, size)
    normals = np.zeros((size, 3))
    normals[np.arange(size), axis] = rng.choice([-1.0, 1.0], size)
    return points, normals


if __name__ == "__main__":
    main()
