"""ScanNet as its exporter writes it: ``color/ depth/ pose/ intrinsic/``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fewview.errors import ScanError
from fewview.geometry import se3
from fewview.scans import cameras, pairing, poses
from fewview.scans.depth_unit import MILLIMETRE, DepthUnit
from fewview.scans.reader import Calibration, Listing
from fewview.types import Array

NAME = "scannet"
LAYOUT = "color/ + depth/ + intrinsic/ (ScanNet export)"


def recognises(path: Path) -> bool:
    """Whether the three folders are there."""
    return all((path / part).is_dir() for part in ("color", "depth", "intrinsic"))


def read(path: Path) -> Listing:
    """List the scans; without ``intrinsic_color.txt`` colour is taken to show depth's view.

    Raises:
        ScanError: half a pair, a doubled name, or no usable ``intrinsic_depth.txt``.
    """
    colour = pairing.by_name(pairing.files(path / "color"))
    shots = pairing.pair(colour, pairing.by_name(pairing.files(path / "depth")))
    unit = DepthUnit(MILLIMETRE, "millimetres, as ScanNet stores them")
    return Listing(shots, _calibration(path / "intrinsic"), unit)


def truth(path: Path) -> dict[str, Array]:
    """``world_T_scan`` of the depth cameras from ``pose/NAME.txt``.

    Raises:
        ScanError: a pose file is unusable.
    """
    names = [shot.name for shot in read(path).shots]
    world_T_reference = poses.read_poses({name: path / "pose" / f"{name}.txt" for name in names})
    reference_T_depth = _extrinsics(path / "intrinsic" / "extrinsic_depth.txt")
    return {name: matrix @ reference_T_depth for name, matrix in world_T_reference.items()}


def calibration(
    depth: cameras.Pinhole,
    colour: cameras.Pinhole | None,
    reference_T_depth: Array,
    reference_T_colour: Array,
) -> Calibration:
    """ScanNet's extrinsics map each camera into the reference camera, which the poses are of."""
    return Calibration(depth, colour, se3.inverse(reference_T_colour) @ reference_T_depth)


def _calibration(folder: Path) -> Calibration:
    depth, colour = folder / "intrinsic_depth.txt", folder / "intrinsic_color.txt"
    if not depth.is_file():
        raise ScanError(
            f"{depth} is missing: write the 3x3 matrix of the depth images there, for example "
            f"'{cameras.EXAMPLE}'"
        )
    return calibration(
        cameras.read_matrix(depth),
        cameras.read_matrix(colour) if colour.is_file() else None,
        _extrinsics(folder / "extrinsic_depth.txt"),
        _extrinsics(folder / "extrinsic_color.txt"),
    )


def _extrinsics(path: Path) -> Array:
    if not path.is_file():
        return np.eye(4)
    matrix = poses.read_pose(path)
    if matrix is None:
        raise ScanError(f"{path} holds NaN or inf: write a finite 4x4 matrix or remove it")
    return matrix
