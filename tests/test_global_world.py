"""The world frame of a component."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from benchmark.planted_graphs import room_poses, upright_levelling
from fewview.geometry import se3
from fewview.global_stage.world import find_world
from fewview.types import Array, Levelling

FRAME_T_WORLD = se3.exp(np.array([0.4, -1.1, 0.8, 3.0, -2.0, 5.0]))


def scene(seed: int, scans: int = 5) -> tuple[Array, dict[int, Array], list[Levelling]]:
    """True poses, the same in an arbitrary frame, and true levellings."""
    poses = room_poses(np.random.default_rng(seed), scans)
    frame = {i: FRAME_T_WORLD @ poses[i] for i in range(scans)}
    return poses, frame, [upright_levelling(p) for p in poses]


@given(st.integers(0, 10_000))
def test_z_is_up_and_the_floor_is_at_zero(seed: int) -> None:
    poses, frame, levellings = scene(seed)
    world = find_world(frame, levellings)
    placed = np.array([world.world_T_frame @ frame[i] for i in range(5)])
    assert world.kind == "floor"
    np.testing.assert_allclose(placed[:, 2, 3], poses[:, 2, 3], atol=1e-9)
    np.testing.assert_allclose(placed[:, 2, :3], poses[:, 2, :3], atol=1e-9)
    np.testing.assert_allclose(placed[0, :2, 3], 0.0, atol=1e-9)
    turn = world.world_T_frame[:3, :3]
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(turn) > 0.0


def test_wrong_levellings_are_outvoted() -> None:
    poses, frame, levellings = scene(1)
    tilted = se3.rotation_exp(np.array([1.2, 0.0, 0.0])) @ levellings[0].level_R_scan
    levellings[0] = Levelling(tilted, 0.9, True, -0.3)
    height = poses[1, 2, 3]
    levellings[1] = Levelling(levellings[1].level_R_scan, 0.7, False, 0.8 - height)
    world = find_world(frame, levellings)
    placed = np.array([world.world_T_frame @ frame[i] for i in range(5)])
    np.testing.assert_allclose(placed[:, 2, 3], poses[:, 2, 3], atol=1e-9)


def test_x_runs_along_the_walls() -> None:
    poses, frame, levellings = scene(2)
    wall = np.array([np.cos(0.6), np.sin(0.6), 0.0])
    level_R_world = np.stack([wall, np.cross([0.0, 0.0, 1.0], wall), [0.0, 0.0, 1.0]])
    levellings[3] = Levelling(level_R_world @ poses[3, :3, :3], 0.8, True, None)
    world = find_world(frame, levellings)
    seen = world.world_T_frame[:3, :3] @ FRAME_T_WORLD[:3, :3] @ wall
    np.testing.assert_allclose(seen, [1.0, 0.0, 0.0], atol=1e-9)


def test_without_a_floor_the_first_camera_is_the_origin() -> None:
    _, frame, levellings = scene(3)
    no_floor = [Levelling(lv.level_R_scan, lv.up_confidence, False, None) for lv in levellings]
    world = find_world(frame, no_floor)
    assert world.kind == "gravity"
    np.testing.assert_allclose((world.world_T_frame @ frame[0])[:3, 3], 0.0, atol=1e-9)


def test_without_confidence_the_image_tells_what_is_down() -> None:
    _, frame, levellings = scene(4)
    unsure = [Levelling(np.eye(3), 0.05, False, -9.0) for _ in levellings]
    world = find_world(frame, unsure)
    assert world.kind == "gravity"
    down = (world.world_T_frame @ frame[0])[:3, 1]
    np.testing.assert_allclose(down, [0.0, 0.0, -1.0], atol=1e-9)


def test_a_camera_looking_straight_down_still_has_a_heading() -> None:
    down = se3.pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.5]))
    world = find_world({0: down, 1: down}, [upright_levelling(down)] * 2)
    np.testing.assert_allclose(world.world_T_frame @ down, down, atol=1e-9)
