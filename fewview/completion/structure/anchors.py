"""Walls by azimuth: what points say about them, and slots that describe them.

A wall is the vertical plane u . x = s with the outward direction u = (cos a, sin a, 0) from the
camera and the distance s, which is negative where the camera is behind the wall. Each of `ANCHORS`
sectors of azimuth a has `SLOTS` slots, nearer wall first.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

ANCHORS = 12
SLOTS = 2
FINE = 3
DIRECTIONS = ANCHORS * FINE
SECTOR = 2.0 * math.pi / ANCHORS
BIN_M = 0.25
BINS = 40
NEAREST_M = -2.0
HEIGHT_BIN_M = 0.1
HEIGHT_BINS = 60
LOWEST_M = -2.5
FULL_COUNT = 4.0
UPRIGHT = 0.7
FLAT = 0.8
SAME_ANGLE = math.radians(20.0)
SAME_M = 0.4


def wall_votes(points: Tensor, normals: Tensor, valid: Tensor) -> Tensor:
    """How many points lie on a wall of each direction and distance.

    A point votes for the two directions nearest to the one that its normal faces away from, and
    there for the two nearest distances.

    Args:
        points: (B, N, 3), wall frame.
        normals: (B, N, 3) towards the camera, 0 unknown.
        valid: (B, N) bool.

    Returns:
        (B, DIRECTIONS, BINS), logarithmic.
    """
    flat = normals[..., :2].norm(dim=-1)
    weight = torch.where(valid & (flat > UPRIGHT), flat, 0.0)
    azimuth = torch.atan2(-normals[..., 1], -normals[..., 0]) / (SECTOR / FINE)
    low = azimuth.floor()
    votes = points.new_zeros(len(points), DIRECTIONS * BINS)
    for step in (0, 1):
        direction = (low.long() + step) % DIRECTIONS
        share = weight * (1.0 - (azimuth - low - step).abs())
        angle = direction * (SECTOR / FINE)
        distance = points[..., 0] * angle.cos() + points[..., 1] * angle.sin()
        votes = _spread(votes, direction, (distance - NEAREST_M) / BIN_M, share, BINS)
    return torch.log1p(votes / FULL_COUNT).reshape(-1, DIRECTIONS, BINS)


def height_votes(points: Tensor, normals: Tensor, valid: Tensor) -> Tensor:
    """(B, 2, HEIGHT_BINS): how many points look up and down at each height, logarithmic."""
    weight = torch.where(valid & (normals[..., 2].abs() > FLAT), 1.0, 0.0)
    side = (normals[..., 2] < 0).long()
    votes = points.new_zeros(len(points), 2 * HEIGHT_BINS)
    at = (points[..., 2] - LOWEST_M) / HEIGHT_BIN_M
    votes = _spread(votes, side, at, weight, HEIGHT_BINS)
    return torch.log1p(votes / FULL_COUNT).reshape(-1, 2, HEIGHT_BINS)


def reach(points: Tensor, valid: Tensor) -> Tensor:
    """(B, DIRECTIONS) how far the points reach in each direction, 0 at least (the camera)."""
    angle = torch.arange(DIRECTIONS, device=points.device) * (SECTOR / FINE)
    directions = torch.stack([angle.cos(), angle.sin()])
    along = (points[..., :2] * valid[..., None]) @ directions
    return along.amax(dim=1)


def _spread(votes: Tensor, row: Tensor, at: Tensor, weight: Tensor, bins: int) -> Tensor:
    """Add weights (B, N) at fractional places ``at`` of rows of ``bins``, linearly split."""
    at = at.clamp(0.5, bins - 0.5) - 0.5
    low = at.floor().clamp(max=bins - 2)
    index = row * bins + low.long()
    votes = votes.scatter_add(1, index, weight * (1.0 - (at - low)))
    return votes.scatter_add(1, index + 1, weight * (at - low))


def anchor_azimuths(like: Tensor) -> Tensor:
    """(ANCHORS * SLOTS,) azimuth of each slot's sector, radians."""
    return (SECTOR * torch.arange(ANCHORS, device=like.device)).repeat_interleave(SLOTS)


def wall_planes(azimuth: Tensor, distance: Tensor) -> Tensor:
    """(..., 4) inward normal and offset of walls with outward azimuths and distances (...)."""
    zero = torch.zeros_like(azimuth)
    return torch.stack([-azimuth.cos(), -azimuth.sin(), zero, -distance], dim=-1)


def wall_feet(azimuth: Tensor, distance: Tensor, middle: Tensor) -> Tensor:
    """(..., 2) x, y of the walls' middles, ``middle`` metres left of the camera's foot point."""
    x = distance * azimuth.cos() - middle * azimuth.sin()
    y = distance * azimuth.sin() + middle * azimuth.cos()
    return torch.stack([x, y], dim=-1)


def distinct(azimuth: Tensor, distance: Tensor, chance: Tensor) -> Tensor:
    """Which walls (B, K) have no more probable one that is nearly the same plane."""
    turn = azimuth[:, :, None] - azimuth[:, None]
    same = torch.atan2(turn.sin(), turn.cos()).abs() < SAME_ANGLE
    same &= (distance[:, :, None] - distance[:, None]).abs() < SAME_M
    return ~(same & (chance[:, None] > chance[:, :, None])).any(dim=2)
