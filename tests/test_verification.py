"""Scans drawn from above, the poses that fit them together, and the verifier."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from fewview.alignment import CHANNELS, Drawing, planar_motion, pose_of
from fewview.alignment.drawing import OBSERVED
from fewview.completion.layout.grid import CELLS, FREE, WALL, cell_centres
from fewview.geometry import se3
from fewview.types import Array, FloatArray
from fewview.verification import VerifierNetwork, plausibility
from fewview.verification.network import GRID, REACH_M, together


def l_shaped(camera_T_room: Array) -> Drawing:
    """An L-shaped room with one piece of furniture, all of it predicted, from a camera in it."""
    x, y = np.moveaxis(se3.transform(se3.inverse(camera_T_room), _centres())[..., :2], -1, 0)
    inside = (np.abs(x) < 2.0) & (np.abs(y) < 1.5) & ~((x > 0.6) & (y > 0.2))
    grown = (np.abs(x) < 2.2) & (np.abs(y) < 1.7) & ~((x > 0.8) & (y > 0.4))
    channels = np.zeros((CHANNELS, CELLS, CELLS), np.float32)
    channels[WALL - 1], channels[FREE - 1] = grown & ~inside, inside
    channels[OBSERVED] = np.arange(CELLS)[:, None] < CELLS // 2
    return Drawing(channels, np.eye(4), -1.4)


def _centres() -> Array:
    flat = cell_centres().astype(np.float64)
    return np.concatenate([flat, np.zeros((*flat.shape[:2], 1))], axis=-1)


def camera(yaw: float, x: float, y: float) -> Array:
    turn = se3.rotation_exp(np.array([0.0, 0.0, yaw]))
    return se3.inverse(se3.pose(turn, np.array([x, y, 0.0])))


def test_floors_meet_in_proposed_poses() -> None:
    low, high = l_shaped(np.eye(4)), l_shaped(np.eye(4))
    high = Drawing(high.channels, high.level_T_scan, -1.1)
    pose = pose_of(low, high, 0.3, np.array([1.0, -2.0]))
    np.testing.assert_allclose(se3.transform(pose, np.array([[0.0, 0.0, -1.4]]))[0, 2], -1.1)
    np.testing.assert_allclose(planar_motion(low, high, pose[None])[0], [0.3, 1.0, -2.0], atol=1e-6)


def test_true_drawings_coincide_when_drawn_together() -> None:
    source, target = camera(0.0, 0.5, -0.5), camera(2.0, -0.5, 0.2)
    first, second = l_shaped(source), l_shaped(target)
    motion = planar_motion(first, second, (target @ se3.inverse(source))[None])
    both = _together(first, second, motion)
    wall, other = both[WALL - 1], both[CHANNELS + WALL - 1]
    assert float(np.minimum(wall, other).sum()) > 0.6 * float(wall.sum())
    wrong = _together(first, second, motion + np.array([[np.pi / 2, 0, 0]], np.float32))
    assert float(np.minimum(*wrong[[WALL - 1, CHANNELS + WALL - 1]]).sum()) < 0.4 * wall.sum()


def test_spots_mark_the_cameras() -> None:
    drawing = l_shaped(np.eye(4))
    both = _together(drawing, drawing, np.array([[0.0, 2.0, 0.0]], np.float32))
    row = [np.unravel_index(int(spot.argmax()), spot.shape)[0] for spot in both[-2:]]
    step = 2 * REACH_M / GRID
    assert (row[1] - row[0]) * step == pytest.approx(2.0, abs=2 * step)


def _together(source: Drawing, target: Drawing, motion: FloatArray) -> FloatArray:
    images = (torch.from_numpy(d.channels)[None] for d in (source, target))
    drawn: FloatArray = together(*images, torch.from_numpy(motion))[0].numpy()
    return drawn


def test_plausibility_depends_on_the_pose_alone() -> None:
    torch.manual_seed(0)
    network = VerifierNetwork().eval()
    source, target = l_shaped(camera(0.0, 0.5, -0.5)), l_shaped(np.eye(4))
    poses = np.stack([camera(a, 0.3, 0.1) for a in (0.0, 1.0, 2.0)])
    together_ = plausibility(source, target, poses, network)
    alone = [float(plausibility(source, target, p[None], network)[0]) for p in poses]
    np.testing.assert_allclose(together_, alone, atol=1e-4)
    assert np.ptp(together_) > 0
    assert plausibility(source, target, poses[:0], network).shape == (0,)
