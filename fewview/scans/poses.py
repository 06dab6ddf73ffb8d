"""Pose files found beside scans; they are ground truth for evaluation and nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fewview.errors import ScanError
from fewview.geometry import se3
from fewview.scans.files import numbers, read_text, table
from fewview.types import Array

_MAX_SKEW = 0.05


def rigid(matrix: Array, label: str) -> Array | None:
    """A (4, 4) pose with an exactly orthonormal rotation, or None when it is not finite.

    Raises:
        ScanError: the matrix is finite but no rigid motion.
    """
    if not np.isfinite(matrix).all():
        return None
    rotation = matrix[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        skew = np.abs(rotation.T @ rotation - np.eye(3)).max()
    proper = skew <= _MAX_SKEW and np.linalg.det(rotation) > 0.0
    if not proper or not np.allclose(matrix[3], [0.0, 0.0, 0.0, 1.0], atol=1e-6):
        raise ScanError(
            f"{label} is not a rigid camera-to-world motion: correct it, or remove it when poses "
            "are not needed"
        )
    return se3.pose(se3.nearest_rotation(rotation), matrix[:3, 3])


def read_pose(path: Path) -> Array | None:
    """A text file of a 4x4 matrix; None when it holds NaN or inf (tracking was lost).

    Raises:
        ScanError: the file holds something else.
    """
    values = numbers(read_text(path), str(path))
    if len(values) != 16:
        raise ScanError(f"{path} holds {len(values)} numbers instead of the 16 of a 4x4 pose")
    return rigid(values.reshape(4, 4), str(path))


def read_poses(files: Mapping[str, Path]) -> dict[str, Array]:
    """The finite poses of those files that exist, by scan name.

    Raises:
        ScanError: see `read_pose`.
    """
    found = {name: read_pose(path) for name, path in files.items() if path.is_file()}
    return {name: matrix for name, matrix in found.items() if matrix is not None}


def read_tum(path: Path) -> tuple[Array, Array]:
    """A TUM trajectory: (n,) seconds, ascending, and (n, 4, 4) camera-to-world poses.

    Raises:
        ScanError: a line is not ``timestamp tx ty tz qx qy qz qw``.
    """
    rows = table(path)
    if any(len(row) != 8 for row in rows):
        raise ScanError(f"{path}: each line must be 'timestamp tx ty tz qx qy qz qw'")
    values = numbers(" ".join(" ".join(row) for row in rows), str(path)).reshape(-1, 8)
    values = values[np.isfinite(values).all(axis=1)]
    if (np.linalg.norm(values[:, 4:], axis=1) < 1e-6).any():
        raise ScanError(f"{path}: a quaternion is zero: remove its line")
    values = values[np.argsort(values[:, 0], kind="stable")]
    rotations = Rotation.from_quat(values[:, 4:]).as_matrix().reshape(-1, 3, 3)
    return values[:, 0], se3.pose(rotations, values[:, 1:4])


def read_log(path: Path) -> list[Array | None]:
    """The poses of a Redwood ``.log`` trajectory: three integers, then a 4x4 matrix, repeated.

    Raises:
        ScanError: the file is not made of such blocks.
    """
    values = numbers(read_text(path), str(path))
    if len(values) % 19:
        raise ScanError(f"{path} is not a trajectory of blocks of 3 integers and a 4x4 matrix")
    blocks = values.reshape(-1, 19)[:, 3:].reshape(-1, 4, 4)
    return [rigid(block, f"pose {i} of {path}") for i, block in enumerate(blocks)]
