"""All poses of a component refined at once by what their scans show (multi-scan registration).

Symmetric point-to-plane distances of nearest neighbours, over every two scans that overlap under
the poses, with Geman-McClure's loss at a falling scale. The selected candidates stay in the
equations, so that scans that barely overlap do not slide along their walls. Surface points that
took no part judge whether the result is kept.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fewview.geometry import se3
from fewview.global_stage.clouds import Cloud, facing, held_out_gaps, overlap
from fewview.global_stage.normal_equations import Facing, Link, gauss_newton_step
from fewview.global_stage.pose_graph import Edge
from fewview.global_stage.shared_planes import Planes, shared
from fewview.types import Array, CompletedScan, Registration

NEIGHBOUR_M = (0.10, 0.10, 0.08, 0.08)
"""Largest distance of nearest neighbours, per alternation; first, also where scans overlap."""

SCALE_M = (0.03, 0.02, 0.015, 0.015)
"""Scale of the loss, per alternation."""

STEPS = 3
"""Gauss-Newton steps per alternation."""

SMALL_STEP = 1e-5
"""Steps below this (rad, m) end an alternation."""

STILL_MEET = 0.9
"""Poses under which fewer of the held-out points meet another scan than this share of those that
met one before are not accepted."""


@dataclass(frozen=True)
class Registered:
    """A component after registration.

    Attributes:
        pose: scan index -> (4, 4) world_T_scan; those given where they were the better ones.
        outcome: what the held-out points say; None where no surfaces meet.
    """

    pose: Mapping[int, Array]
    outcome: Registration | None


def register(
    world_T_scan: Mapping[int, Array],
    scans: Sequence[CompletedScan],
    edges: Sequence[Edge],
    fixed: Collection[int],
    plane_factors: bool,
) -> Registered:
    """Refine the poses of one component.

    Args:
        world_T_scan: scan index -> (4, 4).
        scans: of the whole input.
        edges: the selected candidates that the poses stand on.
        fixed: scans that stay where they are, one at the least.
        plane_factors: whether large planes hold scans together that do not see the same part.
    """
    members = sorted(world_T_scan)
    slot = {scan: k for k, scan in enumerate(members)}
    start = np.stack([world_T_scan[i] for i in members])
    clouds = [Cloud.of(scans[i]) for i in members]
    links = [Link.of(slot[e.source], slot[e.target], e) for e in edges]
    planes = [Planes.of(scans[i]) for i in members] if plane_factors else []
    end = _fitted(start, clouds, links, planes, {slot[i] for i in fixed})
    outcome = judge(clouds, start, end)
    kept = end if outcome is not None and outcome.accepted else start
    return Registered(dict(zip(members, kept, strict=True)), outcome)


def judge(clouds: Sequence[Cloud], before: Array, after: Array) -> Registration | None:
    """Compare (m, 4, 4) poses by held-out points that meet another scan under both.

    Returns:
        their mean distances from the other scans' surfaces, None where none meet.
    """
    gaps = [
        np.stack(
            [held_out_gaps(clouds[i], clouds[j], se3.inverse(p[j]) @ p[i]) for p in (before, after)]
        )
        for i, j in itertools.permutations(range(len(clouds)), 2)
    ]
    every = np.concatenate(gaps, axis=1)
    met = np.isfinite(every)
    both = met.all(axis=0)
    if not both.any():
        return None
    before_m, after_m = every[:, both].mean(axis=1)
    still_meet = met[1].sum() >= STILL_MEET * met[0].sum()
    return Registration(float(before_m), float(after_m), bool(after_m < before_m and still_meet))


def _fitted(
    start: Array,
    clouds: list[Cloud],
    links: Sequence[Link],
    planes: Sequence[Planes],
    fixed: Collection[int],
) -> Array:
    """Alternate between nearest neighbours and Gauss-Newton; (m, 4, 4)."""
    ordered = itertools.permutations(range(len(clouds)), 2)
    met = [overlap(clouds, start, i, j, NEIGHBOUR_M[0]) for i, j in ordered]
    overlaps = [where for where in met if where is not None]
    poses = start.copy()
    for radius, scale in zip(NEIGHBOUR_M, SCALE_M, strict=True):
        points = [facing(clouds, poses, where, radius, scale) for where in overlaps]
        terms: list[Facing | Link] = [*links, *points, *shared(planes, poses, scale)]
        for _ in range(STEPS):
            step = gauss_newton_step(poses, terms, fixed)
            poses = se3.exp(step) @ poses
            if np.abs(step).max() < SMALL_STEP:
                break
    moved = [k for k in range(len(poses)) if k not in fixed]
    poses[moved, :3, :3] = se3.nearest_rotation(poses[moved, :3, :3])
    return poses
