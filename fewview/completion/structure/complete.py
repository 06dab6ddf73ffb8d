"""The structural planes of the room of one scan, and what each of its points belongs to."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import torch

from fewview import weights
from fewview.completion.layout.pointnet import PointBatch
from fewview.completion.layout.points import ScanPoints
from fewview.completion.structure import anchors
from fewview.completion.structure.network import (
    LevelPrediction,
    StructureNetwork,
    StructureNetworkConfig,
    WallPrediction,
)
from fewview.types import Array, BoolArray, CompletedPlanes, FloatArray, StructuralPlane

NAME = "structure"
MIN_CONFIDENCE = 0.3
NEAR_M = 0.25
ALIKE_COS = float(np.cos(np.radians(25.0)))
MIN_SUPPORT = 30
REFITS = 2
RIGHT_M = 0.3


@cache
def shipped_network() -> StructureNetwork:
    """The network with the weights that come with the package.

    Raises:
        FewviewError: they are missing or damaged.
    """
    return weights.shipped(NAME, lambda size: StructureNetwork(StructureNetworkConfig(**size)))


def complete_planes(scan: ScanPoints, network: StructureNetwork | None = None) -> CompletedPlanes:
    """Predict the structural planes around a scan.

    Args:
        scan: its points.
        network: the shipped one when not given.

    Raises:
        FewviewError: the shipped weights are missing or damaged.
    """
    network = shipped_network() if network is None else network
    device = next(network.parameters()).device
    batch = PointBatch(*(t.to(device) for t in PointBatch.of([scan])))
    with torch.inference_mode():
        points, walls, levels = network(batch)
    floor, ceiling = _levels(scan, LevelPrediction(*(t.cpu() for t in levels)))
    height = 0.5 * (floor.centre[2] + ceiling.centre[2])
    upright = _walls(scan, WallPrediction(*(t.cpu() for t in walls)), height)
    wall_R_level = scan.wall_R_level
    return CompletedPlanes(
        planes=tuple(_turned_plane(p, wall_R_level) for p in (floor, ceiling, *upright)),
        normals=points.normal[0].cpu().numpy() @ wall_R_level,
        centres=(scan.points + points.offset[0].cpu().numpy()) @ wall_R_level,
        semantics=points.semantics[0].softmax(dim=-1).cpu().numpy(),
        descriptors=points.descriptor[0].cpu().numpy(),
        confidence=1.0 - np.exp(-RIGHT_M / points.log_scale[0].exp().cpu().numpy()),
    )


def _turned_plane(plane: StructuralPlane, wall_R_level: FloatArray) -> StructuralPlane:
    return replace(plane, centre=plane.centre @ wall_R_level, normal=plane.normal @ wall_R_level)


def _levels(scan: ScanPoints, levels: LevelPrediction) -> list[StructuralPlane]:
    out = []
    for i, (kind, up) in enumerate((("floor", 1.0), ("ceiling", -1.0))):
        plane = np.array([0.0, 0.0, up, up * float(levels.height[0, i])])
        centre = np.array([0.0, 0.0, float(levels.height[0, i])])
        sure = _within(float(levels.log_scale[0, i]))
        out.append(_plane(kind, scan, plane, centre, levels.descriptor[0, i].numpy(), sure))
    return out


def _walls(scan: ScanPoints, walls: WallPrediction, height: float) -> list[StructuralPlane]:
    chance = walls.exists.sigmoid()
    kept = anchors.distinct(walls.azimuth, walls.distance, chance) & (chance > MIN_CONFIDENCE)
    planes = anchors.wall_planes(walls.azimuth, walls.distance)[0].double().numpy()
    feet = anchors.wall_feet(walls.azimuth, walls.distance, walls.middle)[0].double().numpy()
    out = []
    for i in np.flatnonzero(kept[0].numpy()):
        sure = float(chance[0, i]) * _within(float(walls.distance_log_scale[0, i]))
        centre = np.append(feet[i], height)
        out.append(_plane("wall", scan, planes[i], centre, walls.descriptor[0, i].numpy(), sure))
    return sorted(out, key=lambda plane: -plane.confidence)


def _within(log_scale: float) -> float:
    """Probability that a Laplace distributed error is below `RIGHT_M`."""
    return float(1.0 - np.exp(-RIGHT_M / np.exp(log_scale)))


def _plane(
    kind: str, scan: ScanPoints, plane: Array, centre: Array, descriptor: FloatArray, sure: float
) -> StructuralPlane:
    plane, observed = snapped(plane, scan, upright=kind == "wall")
    centre = centre - (plane[:3] @ centre - plane[3]) * plane[:3]
    return StructuralPlane(kind, centre, plane[:3], descriptor, sure, observed)


def snapped(plane: Array, scan: ScanPoints, upright: bool) -> tuple[Array, bool]:
    """Move a plane to the points that lie on it.

    Args:
        plane: (4,) normal and offset n . x = d.
        scan: the points.
        upright: turn it about the vertical too; otherwise it is only shifted.

    Returns:
        The plane, and whether enough points lie on it; if not it is as it was.
    """
    points, normals = scan.points.astype(np.float64), scan.normals.astype(np.float64)
    for _ in range(REFITS):
        on = _members(plane, points, normals, scan.valid)
        if on.sum() < MIN_SUPPORT:
            return plane, False
        if upright:
            plane = _turned(plane, points[on], normals[on])
        plane = np.append(plane[:3], np.median(points[on] @ plane[:3]))
    return plane, True


def _members(plane: Array, points: Array, normals: Array, valid: BoolArray) -> BoolArray:
    near = np.abs(points @ plane[:3] - plane[3]) < NEAR_M
    return np.asarray(near & valid & (normals @ plane[:3] > ALIKE_COS))


def _turned(plane: Array, points: Array, normals: Array) -> Array:
    """The vertical plane's least-squares normal, when its points say enough about it."""
    flat = points[:, :2] - points[:, :2].mean(axis=0)
    values, axes = np.linalg.eigh(flat.T @ flat / len(flat))
    normal = np.append(axes[:, 0] * np.sign(axes[:, 0] @ plane[:2]), 0.0)
    steady = values[1] > 10.0 * values[0] and normal @ plane[:3] > ALIKE_COS
    return np.append(normal, plane[3]) if steady else plane
