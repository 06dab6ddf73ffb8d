"""How a scan stands in its room: up direction, Manhattan frame and floor.

Indoor surfaces are mostly horizontal or vertical. Every patch normal, every cross product of two
wall normals and the camera's own up axis proposes an up direction; the one that most surface
agrees with wins and is refined by weighted least squares on the normals.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fewview.types import Array, Levelling, PlanarPatch, Surface

MAX_TILT_DEG = 50.0
AGREE_DEG = 8.0
CAMERA_AGREEMENT_WEIGHT = 0.15
MIN_WALL_SHARE = 0.08
FLOOR_RANGE_M = (0.25, 2.6)
DOUBTED_M = 0.3


def level(
    surface: Surface,
    patches: tuple[PlanarPatch, ...],
    quarter_turns: int = 0,
    up: Array | None = None,
) -> Levelling:
    """Estimate the levelling of one scan.

    Args:
        surface: its visible surface, camera frame.
        patches: its planar patches.
        quarter_turns: how often the image must be turned by 90 degrees counter-clockwise to
            stand upright; it turns the camera's up axis.
        up: (3,) unit up direction in the camera frame where it is known; it is not doubted, and
            walls and floor are looked for along it.
    """
    confidence = 0.0 if up is None else 1.0
    camera_up = upright(quarter_turns) if up is None else up
    if len(surface.points) < 10:
        return Levelling(_frame(camera_up, _forward(camera_up)), confidence, False, None)
    if up is None:
        up, confidence = _up_direction(surface.normals, patches, camera_up)
    heading, manhattan = _heading(surface.normals, up)
    level_R_scan = _frame(up, heading)
    return Levelling(level_R_scan, confidence, manhattan, _floor(surface, up))


def doubted(levelling: Levelling, predicted_floor_z: float) -> Levelling:
    """The levelling without a floor that it took something else for, by a predicted height.

    A table top or a bed that hides the floor is the lowest large surface in a fifth of the views.
    """
    floor_z = levelling.floor_z
    if floor_z is None or abs(floor_z - predicted_floor_z) < DOUBTED_M:
        return levelling
    return replace(levelling, floor_z=None)


def turns_upright(up: Array) -> int:
    """Counter-clockwise quarter turns that best bring an image with this (3,) up upright."""
    return int(np.argmax([upright(turns) @ up for turns in range(4)]))


def upright(quarter_turns: int) -> Array:
    """The camera's up axis when its image needs that many counter-clockwise quarter turns."""
    axes = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))
    return np.array(axes[quarter_turns % 4])


def _up_direction(
    normals: Array, patches: tuple[PlanarPatch, ...], camera_up: Array
) -> tuple[Array, float]:
    axes = np.array([p.normal for p in patches]).reshape(-1, 3)
    pairs = np.cross(axes[:, None], axes[None]).reshape(-1, 3)
    length = np.linalg.norm(pairs, axis=1)
    pairs = pairs[length > 0.7] / length[length > 0.7, None]
    proposals = np.concatenate([camera_up[None], axes, pairs])
    proposals *= np.where(proposals @ camera_up < 0, -1.0, 1.0)[:, None]
    proposals = proposals[proposals @ camera_up > np.cos(np.radians(MAX_TILT_DEG))]
    scores = _agreement(normals, proposals) + CAMERA_AGREEMENT_WEIGHT * proposals @ camera_up
    up = proposals[int(scores.argmax())]
    for _ in range(3):
        up = _refined_up(normals, up)
    return up, float(_agreement(normals, up[None])[0])


def _agreement(normals: Array, ups: Array) -> Array:
    cosines = np.abs(normals @ ups.T)
    horizontal = cosines > np.cos(np.radians(AGREE_DEG))
    vertical = cosines < np.sin(np.radians(AGREE_DEG))
    both = np.sqrt(horizontal.mean(axis=0) * vertical.mean(axis=0))
    return np.asarray(horizontal.mean(axis=0) + vertical.mean(axis=0) + 0.5 * both) / 1.25


def _refined_up(normals: Array, up: Array) -> Array:
    cosine = normals @ up
    horizontal = normals[np.abs(cosine) > np.cos(np.radians(AGREE_DEG))]
    vertical = normals[np.abs(cosine) < np.sin(np.radians(AGREE_DEG))]
    scatter = vertical.T @ vertical - horizontal.T @ horizontal - 1e-6 * np.outer(up, up)
    _, axes = np.linalg.eigh(scatter)
    refined = axes[:, 0] * np.sign(axes[:, 0] @ up)
    return np.asarray(refined if refined @ up > np.cos(np.radians(AGREE_DEG)) else up)


def _heading(normals: Array, up: Array) -> tuple[Array, bool]:
    walls = normals[np.abs(normals @ up) < np.sin(np.radians(2 * AGREE_DEG))]
    forward = _forward(up)
    if len(walls) < MIN_WALL_SHARE * len(normals):
        return forward, False
    side = np.cross(up, forward)
    angles = np.arctan2(walls @ side, walls @ forward)
    phase = _dominant_phase(angles)
    near = np.abs((angles - phase + np.pi / 4) % (np.pi / 2) - np.pi / 4) < np.radians(AGREE_DEG)
    manhattan = bool(near.mean() > 0.45)
    return np.cos(phase) * forward + np.sin(phase) * side, manhattan


def _dominant_phase(angles: Array) -> float:
    """The wall direction modulo 90 degrees with most support, refined by a circular mean."""
    counts, _ = np.histogram(angles % (np.pi / 2), bins=90, range=(0.0, np.pi / 2))
    wrapped = np.concatenate([counts[-3:], counts, counts[:3]])
    smooth = np.convolve(wrapped, np.ones(7), mode="valid")
    peak = (int(smooth.argmax()) + 0.5) * np.pi / 180.0
    near = angles[
        np.abs((angles - peak + np.pi / 4) % (np.pi / 2) - np.pi / 4) < np.radians(AGREE_DEG)
    ]
    return float(np.angle(np.exp(4j * near).mean()) / 4.0)


def _floor(surface: Surface, up: Array) -> float | None:
    """Height of the lowest large horizontal surface that faces up, below the camera."""
    heights = surface.points @ up
    facing_up = surface.normals @ up > np.cos(np.radians(2 * AGREE_DEG))
    below = facing_up & (heights < -FLOOR_RANGE_M[0]) & (heights > -FLOOR_RANGE_M[1])
    if below.sum() < max(30, 0.03 * len(heights)):
        return None
    counts, edges = np.histogram(heights[below], bins=np.arange(-FLOOR_RANGE_M[1], 0.05, 0.05))
    smooth = np.convolve(counts, np.ones(3), mode="same")
    strong = np.flatnonzero(smooth > 0.35 * smooth.max())
    low = edges[strong[0]]
    members = below & (np.abs(heights - low - 0.025) < 0.1)
    if (heights < low - 0.15).sum() > 0.03 * len(heights):
        return None
    return float(np.median(heights[members]))


def _forward(up: Array) -> Array:
    """The viewing direction (or the image's x axis when looking along ``up``) made horizontal."""
    for axis in (np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])):
        flat = axis - (axis @ up) * up
        if np.linalg.norm(flat) > 0.3:
            break
    return np.asarray(flat / np.linalg.norm(flat))


def _frame(up: Array, heading: Array) -> Array:
    heading = heading - (heading @ up) * up
    heading = heading / np.linalg.norm(heading)
    return np.stack([heading, np.cross(up, heading), up])
