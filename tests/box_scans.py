"""Scans of a small box-shaped room and of a corridor, with their true poses: surfaces alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmark.planted_graphs import room_poses, upright_levelling
from fewview.geometry import se3
from fewview.global_stage.shared_planes import LEAST_POINTS
from fewview.types import (
    Array,
    CompletedRoom,
    CompletedScan,
    Intrinsics,
    PlanarPatch,
    RingScan,
    Surface,
)

SIZE = np.array([2.4, 2.0, 1.8])
SCANS = 4
NOISE_M = 0.004


def box(rng: np.random.Generator, count: int = 4000) -> tuple[Array, Array]:
    """Points and normals on the inside of a box around the origin."""
    face = rng.integers(0, 6, count)
    axis, side = face // 2, 2.0 * (face % 2) - 1.0
    points, normals = rng.uniform(-0.5, 0.5, (count, 3)), np.zeros((count, 3))
    points[np.arange(count), axis] = 0.5 * side
    normals[np.arange(count), axis] = -side
    return points * SIZE, normals


def scan_of(
    world_T_scan: Array, points: Array, normals: Array, patches: Sequence[PlanarPatch] = ()
) -> CompletedScan:
    """A scan that shows points of the world."""
    scan_T_world = se3.inverse(world_T_scan)
    count = len(points)
    surface = Surface(
        se3.transform(scan_T_world, points),
        se3.rotate(scan_T_world, normals),
        np.zeros((count, 3), np.float32),
        np.full(count, -1),
    )
    nothing = np.zeros((1, 4), np.float32)
    ring = RingScan(np.zeros((1, 4, 3), np.uint8), nothing, np.eye(4))
    return CompletedScan(
        name="scan",
        image_size=(1, 1),
        quarter_turns=0,
        intrinsics=Intrinsics(1, 1, 1.0, 1.0, 0.0, 0.0),
        depth=nothing,
        surface=surface,
        patches=tuple(patches),
        levelling=upright_levelling(world_T_scan),
        room=CompletedRoom(ring),
        features={},
    )


def room(seed: int, noise_m: float = NOISE_M) -> tuple[Array, list[CompletedScan]]:
    """True poses and scans; each shows the half of the box around its heading."""
    rng = np.random.default_rng(seed)
    poses = room_poses(rng, SCANS)
    poses[:, :3, 3] *= 0.1
    scans = []
    for k, pose in enumerate(poses):
        points, normals = box(rng)
        heading = 2.0 * np.pi * k / SCANS
        seen = points[:, :2] @ [np.cos(heading), np.sin(heading)] > 0.0
        points = points[seen] + rng.normal(0.0, noise_m, (int(seen.sum()), 3))
        scans.append(scan_of(pose, points, normals[seen]))
    return poses, scans


def corridor(seed: int) -> tuple[Array, list[CompletedScan]]:
    """Scans along a corridor, each a metre further; neighbours share a strip of 15 cm."""
    rng = np.random.default_rng(seed)
    truth = np.tile(np.eye(4), (SCANS, 1, 1))
    scans = []
    for k in range(SCANS):
        truth[k, 0, 3] = k
        points, normals, patches = [], [], []
        for axis, sign in ((1, 1.0), (1, -1.0), (2, 1.0)):
            face = rng.uniform(-1.0, 1.0, (LEAST_POINTS, 3))
            face[:, 0] = rng.uniform(k, k + 1.15, LEAST_POINTS)
            face[:, axis] = sign * SIZE[axis] / 2
            normal = np.zeros(3)
            normal[axis] = -sign
            points.append(face + rng.normal(0.0, NOISE_M, face.shape))
            normals.append(np.tile(normal, (LEAST_POINTS, 1)))
            centre = face.mean(axis=0) - truth[k, :3, 3]
            patches.append(PlanarPatch(centre, normal, np.full(2, 0.5), LEAST_POINTS))
        scans.append(scan_of(truth[k], np.concatenate(points), np.concatenate(normals), patches))
    return truth, scans
