"""What can be measured of point pairs under a pose, as input of the relation network.

Every pair is measured twice: under the pose itself, and under the pose squared up, which keeps
verticals vertical and walls parallel. Both scans stand in level frames along their walls, so a
rotation that is wrong by less than 45 degrees is right once it is squared up, if the walls of the
two scans are parallel; whether they are is the network's to judge.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

GEOMETRY = 10
DISTANCE_SCALE = 0.25
QUARTER = 0.5 * torch.pi


class PosedPairs(NamedTuple):
    """Point pairs of Q pairs of scans, each under one pose; several may be of the same two scans.

    Attributes:
        source, target: (Q,) index of the scans.
        target_T_source: (Q, 4, 4) between their level frames.
        source_point, target_point: (Q, M) rows of the scans' points.
    """

    source: Tensor
    target: Tensor
    target_T_source: Tensor
    source_point: Tensor
    target_point: Tensor


def pair_geometry(points: Tensor, normals: Tensor, pairs: PosedPairs) -> Tensor:
    """(Q, M, GEOMETRY) measures of point pairs: `measures` under the poses, then squared up.

    Args:
        points, normals: (S, N, 3) of S scans in their level frames.
        pairs: which of them, under which poses.
    """
    p, n = (picked(values, pairs.source, pairs.source_point) for values in (points, normals))
    q, m = (picked(values, pairs.target, pairs.target_point) for values in (points, normals))
    poses = (pairs.target_T_source, squared_up(pairs.target_T_source))
    return torch.cat([measures(*moved(p, n, pose), q, m) for pose in poses], dim=-1)


def picked(values: Tensor, scan: Tensor, row: Tensor) -> Tensor:
    """The rows (Q, M) of the scans (Q,) out of (S, N, C): (Q, M, C)."""
    at = scan[:, None] * values.shape[1] + row
    return values.flatten(0, 1).index_select(0, at.flatten()).view(*row.shape, values.shape[2])


def moved(points: Tensor, normals: Tensor, target_T_source: Tensor) -> tuple[Tensor, Tensor]:
    """Points and normals (Q, n, 3) under poses (Q, 4, 4)."""
    turn = target_T_source[:, :3, :3].mT
    return points @ turn + target_T_source[:, None, :3, 3], normals @ turn


def measures(
    source: Tensor, source_normals: Tensor, target: Tensor, target_normals: Tensor
) -> Tensor:
    """Of points (Q, M, 3) and unit normals in one frame (Q, M, 5): cosine and sine of the angle
    between the normals, signed distances of each point from the other's plane, and of the points.

    The sine tells angles near 0, the cosine those near 90 degrees.
    """
    gap = source - target
    return torch.stack(
        [
            (source_normals * target_normals).sum(dim=-1),
            torch.linalg.cross(source_normals, target_normals).norm(dim=-1),
            (gap * source_normals).sum(dim=-1),
            (gap * target_normals).sum(dim=-1),
            DISTANCE_SCALE * gap.norm(dim=-1),
        ],
        dim=-1,
    )


def squared_up(target_T_source: Tensor) -> Tensor:
    """Poses (Q, 4, 4) between level frames with their rotation replaced by the nearest quarter
    turn about the vertical."""
    turn = target_T_source[:, :2, :2]
    yaw = torch.atan2(turn[:, 1, 0] - turn[:, 0, 1], turn[:, 0, 0] + turn[:, 1, 1])
    angle = (yaw / QUARTER).round() * QUARTER
    out = target_T_source.clone()
    out[:, :3, :3] = torch.eye(3, dtype=out.dtype, device=out.device)
    out[:, 0, 0] = out[:, 1, 1] = angle.cos().round()
    out[:, 1, 0] = angle.sin().round()
    out[:, 0, 1] = -out[:, 1, 0]
    return out
