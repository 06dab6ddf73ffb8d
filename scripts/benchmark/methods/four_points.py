"""Super4PCS: global registration without descriptors (Mellado, Aiger and Mitra, SGP 2014)."""

from __future__ import annotations

import math
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import open3d as o3d
from scipy.spatial import KDTree

from benchmark.methods.clouds import Coarse, CoarseToFine, View
from benchmark.methods.common_set import Vicinity, largest
from benchmark.methods.congruent_sets import (
    MAX_NORMAL_DEG,
    Base,
    Sample,
    congruent_sets,
    wide_base,
)
from benchmark.methods.kabsch import kabsch
from fewview.geometry import se3
from fewview.types import Array, Frame

BINARY = "Super4PCS"
OVERLAPS = (0.8, 0.5, 0.3)
"""Expected overlaps, tried in turn until one is reached."""
DELTA_M = 0.05
"""The authors' delta: neighbours at this distance belong to the common set."""
TOLERANCE_M = 2.0 * DELTA_M
"""Congruent points may be off by twice delta, as in the authors' code."""
SAMPLES = 600
MISS_PROBABILITY = 0.01
"""Probability with which no base is to lie inside the expected overlap ..."""
MAX_BASES = 20
"""... as far as this many bases an expected overlap allow."""
REFITS = 10
MAX_SECONDS = 10
"""What the binary may take for one expected overlap."""


@dataclass(frozen=True)
class Indexed:
    """A scan ready for four points: samples in random order, and where its surface is."""

    sample: Sample
    tree: KDTree
    vicinity: Vicinity


class FourPoints(CoarseToFine):
    """4PCS alone as in the paper's table: congruent sets, largest common set, refit to it.

    The binary ``Super4PCS`` of the authors' OpenGR is run where it is on PATH, with the same
    delta, samples, normals and overlaps; else congruent sets are searched here. Normals prune
    matches (30 degrees); colours do not, which is the tool's default too.

    Args:
        icp: refine by the two-stage ICP of the other methods.
    """

    def __init__(self, icp: bool = False) -> None:
        super().__init__(icp)

    def features(self, frame: Frame, cloud: o3d.geometry.PointCloud) -> Indexed:
        """Samples with their pairs, and the index of the whole cloud."""
        points, normals = np.asarray(cloud.points), np.asarray(cloud.normals)
        order = np.random.default_rng(0).permutation(len(points))[:SAMPLES]
        sample = Sample.of(points[order], normals[order])
        return Indexed(sample, KDTree(points), Vicinity.of(points, DELTA_M))

    def register(self, source: View, target: View) -> Coarse | None:
        """The pose with the largest common set, refitted to it by least squares."""
        binary = shutil.which(BINARY)
        if binary is None:
            found = _search(source.features, target.features)
        else:
            found = _run(binary, source, target)
        if found is None:
            return None
        pose = _refitted(found, source.features, target.features)
        return pose, _common(pose, source.features, target.features)


def _search(source: Indexed, target: Indexed) -> Array | None:
    """RANSAC over bases of the target, as many as the expected overlap demands."""
    rng = np.random.default_rng(0)
    best, size = None, 0
    for overlap in OVERLAPS:
        wanted = math.log(MISS_PROBABILITY) / math.log(1.0 - overlap**4)
        max_side = overlap * float(target.sample.distances[-1])
        for _ in range(min(MAX_BASES, math.ceil(wanted))):
            base = wide_base(target.sample, max_side, DELTA_M, rng)
            if base is None:
                continue
            poses = _poses(base, source.sample)
            winner = largest(poses, source.sample.points, target.vicinity, size)
            if winner is not None:
                best, size = poses[winner[0]], winner[1]
        if size >= overlap * len(source.sample.points):
            break
    return best


def _poses(base: Base, sample: Sample) -> Array:
    """target_T_source (k, 4, 4) of congruent sets that fit and whose normals agree."""
    sets = congruent_sets(base, sample, TOLERANCE_M)
    if not len(sets):
        return np.empty((0, 4, 4))
    poses = kabsch(sample.points[sets], base.points)
    misfit = se3.transform(poses, sample.points[sets]) - base.points
    fits = np.sqrt((misfit**2).sum(axis=-1).mean(axis=-1)) < TOLERANCE_M
    cosines = (se3.rotate(poses, sample.normals[sets]) * base.normals).sum(axis=-1)
    agree = (cosines > math.cos(math.radians(MAX_NORMAL_DEG))).all(axis=-1)
    return np.asarray(poses[fits & agree])


def _refitted(pose: Array, source: Indexed, target: Indexed) -> Array:
    """Point-to-point least squares on the common set; it may grow meanwhile."""
    for _ in range(REFITS):
        moved = se3.transform(pose, source.sample.points)
        distance, nearest = target.tree.query(moved, distance_upper_bound=TOLERANCE_M)
        common = np.isfinite(distance)
        if common.sum() < 3:
            break
        pose = kabsch(source.sample.points[common], target.tree.data[nearest[common]])
    return pose


def _common(pose: Array, source: Indexed, target: Indexed) -> int:
    return int(target.vicinity.hits(se3.transform(pose, source.sample.points)).sum())


def _run(binary: str, source: View, target: View) -> Array | None:
    """The tool's answer with the largest common set over the expected overlaps."""
    found = []
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / name for name in ("target.obj", "source.obj", "pose.txt")]
        for path, view in zip(files[:2], (target, source), strict=True):
            path.write_text(_obj(view.cloud))
        for overlap in OVERLAPS:
            options = f"-o {overlap} -d {DELTA_M} -t {MAX_SECONDS} -n {SAMPLES} -a {MAX_NORMAL_DEG}"
            command = [binary, "-i", *map(str, files[:2]), *options.split(), "-m", str(files[2])]
            subprocess.run(command, check=True, capture_output=True)
            found.append(np.loadtxt(files[2], skiprows=2))
            if _common(found[-1], source.features, target.features) >= overlap * SAMPLES:
                break
    return max(found, key=lambda pose: _common(pose, source.features, target.features))


def _obj(cloud: o3d.geometry.PointCloud) -> str:
    """Vertices and normals as OBJ, which every version of the tool reads."""
    return "".join(
        f"{kind} {x:.6f} {y:.6f} {z:.6f}\n"
        for kind, rows in (("v", cloud.points), ("vn", cloud.normals))
        for x, y, z in np.asarray(rows)
    )
