"""The lift between levelled scans: from floors, or from what stands at which height."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from fewview import synthetic
from fewview.completion import complete
from fewview.config import FeatureConfig
from fewview.geometry import se3
from fewview.matching.heights import BIN_M, height_profile, lift, lifted
from fewview.types import CompletedScan


@pytest.fixture(scope="module")
def scans() -> tuple[CompletedScan, CompletedScan]:
    """Two views of a room."""
    scene = synthetic.generate(synthetic.split_seed("test", 7), 2, width=320, height=240)
    a, b = (complete("scan", frame, 0, FeatureConfig(), 0) for frame in scene.frames)
    return a, b


def with_floor(scan: CompletedScan, floor_z: float | None) -> CompletedScan:
    """The scan with another floor, and no completed room."""
    levelling = dataclasses.replace(scan.levelling, floor_z=floor_z)
    room = dataclasses.replace(scan.room, layout=None, planes=None)
    return dataclasses.replace(scan, levelling=levelling, room=room)


def test_floors_tell_the_lift(scans: tuple[CompletedScan, CompletedScan]) -> None:
    a, b = with_floor(scans[0], -1.2), with_floor(scans[1], -1.6)
    profiles = height_profile(a), height_profile(b)
    assert lift(a, b, *profiles) == pytest.approx(-0.4)
    assert lift(b, a, *profiles[::-1]) == pytest.approx(0.4)


@pytest.mark.parametrize("steps", [-5, 0, 4])
def test_without_floors_profiles_tell_it(
    scans: tuple[CompletedScan, CompletedScan], steps: int
) -> None:
    scan = with_floor(scans[0], None)
    profile = height_profile(scan)
    higher = np.roll(profile, steps, axis=1)
    assert lift(scan, scan, profile, higher) == pytest.approx(steps * BIN_M)


def test_a_pose_moves_along_the_vertical_alone(
    scans: tuple[CompletedScan, CompletedScan],
) -> None:
    target = scans[1]
    up = target.levelling.level_R_scan[2]
    pose = se3.pose(se3.rotation_exp(0.3 * up), np.array([0.5, -0.2, 1.0]))
    moved = lifted(pose, target, 0.7)
    assert moved[:3, 3] @ up == pytest.approx(0.7)
    np.testing.assert_allclose(np.cross(moved[:3, 3] - pose[:3, 3], up), 0.0, atol=1e-12)
    np.testing.assert_array_equal(moved[:3, :3], pose[:3, :3])
