"""Figures of merit of predicted planes, beside a box put around what was seen."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from fewview.completion.structure import anchors
from fewview.completion.structure.network import LevelPrediction, PointPrediction, WallPrediction
from fewview.training.plane_matches import seen_planes
from fewview.training.point_batches import WALL
from fewview.training.problem import Batch

TOLERANCES = {"": (15.0, 0.3), "_strict": (10.0, 0.2)}
BELIEVED = 0.5
BOX_TRIM = 0.98


def plane_figures(walls: WallPrediction, levels: LevelPrediction, batch: Batch) -> dict[str, float]:
    """Precision and recall of walls, within 15 deg / 0.3 m and (strict) 10 deg / 0.2 m.

    Recall apart for walls that the scan shows and does not show. The same for the box, names
    ``box_...``. Mean errors of the distances of true walls, of azimuth, and of both heights.
    """
    chance = walls.exists.sigmoid()
    kept = anchors.distinct(walls.azimuth, walls.distance, chance) & (chance > BELIEVED)
    answers = {"": (walls.azimuth, walls.distance, kept), "box_": box_walls(batch)}
    out: dict[str, float] = {}
    for name, answer in answers.items():
        for suffix, (angle, away) in TOLERANCES.items():
            found = _precision_recall(*answer, batch, math.radians(angle), away)
            out |= {f"{name}{k}{suffix}": v for k, v in found.items()}
    return out | _wall_errors(walls, batch) | _level_errors(levels, batch)


def _precision_recall(
    azimuth: Tensor, distance: Tensor, kept: Tensor, batch: Batch, angle: float, away: float
) -> Mapping[str, float]:
    plane = batch["plane"]
    true_azimuth = torch.atan2(-plane[..., 1], -plane[..., 0])
    true = (batch["plane_kind"] == WALL) & (-plane[..., 3] > 0)
    turn = azimuth[:, :, None] - true_azimuth[:, None]
    same = torch.atan2(turn.sin(), turn.cos()).abs() < angle
    same &= (distance[:, :, None] + plane[:, None, :, 3]).abs() < away
    same &= kept[:, :, None] & true[:, None]
    found, seen = same.any(dim=1), seen_planes(batch)
    return {
        "recall_seen": mean_of(found, true & seen),
        "recall_unseen": mean_of(found, true & ~seen),
        "precision": mean_of(same.any(dim=2), kept),
    }


def box_walls(batch: Batch) -> tuple[Tensor, Tensor, Tensor]:
    """Four walls along the true wall that shows most points, around all points and the camera.

    Returns:
        azimuth, distance (B, 4) and whether there is any wall to go by (B, 4).
    """
    label = batch["point_plane"]
    upright = batch["plane_kind"].gather(1, label.clamp(min=0)) == WALL
    counts = torch.zeros_like(batch["plane_kind"])
    counts = counts.scatter_add(1, label.clamp(min=0), ((label >= 0) & upright).long())
    normal = batch["plane"][torch.arange(len(counts)), counts.argmax(dim=1)]
    first = torch.atan2(-normal[:, 1], -normal[:, 0])
    azimuth = first[:, None] + 0.5 * math.pi * torch.arange(4, device=label.device)
    out = torch.stack([azimuth.cos(), azimuth.sin()], dim=1)
    along = (batch["points"][..., :2] * batch["valid"][..., None]) @ out
    distance = along.quantile(BOX_TRIM, dim=1).clamp(min=0.0)
    return azimuth, distance, (counts.amax(dim=1) > 0)[:, None].expand(-1, 4)


def _wall_errors(walls: WallPrediction, batch: Batch) -> dict[str, float]:
    slot = batch["wall_plane"]
    seen = seen_planes(batch).gather(1, slot.clamp(min=0))
    away = (walls.distance - batch["wall_distance"]).abs()
    beside = (walls.middle - batch["wall_middle"]).abs()
    turn = walls.azimuth - batch["wall_azimuth"]
    turn = torch.rad2deg(torch.atan2(turn.sin(), turn.cos()).abs())
    there, out = slot >= 0, {}
    for name, group in (("seen", there & seen), ("unseen", there & ~seen)):
        out[f"distance_m_{name}"] = float(away[group].mean())
        out[f"distance_median_m_{name}"] = float(away[group].median()) if group.any() else math.nan
        out[f"azimuth_deg_{name}"] = float(turn[group].mean())
        out[f"middle_m_{name}"] = float(beside[group & batch["wall_middle_known"]].mean())
    return out


def _level_errors(levels: LevelPrediction, batch: Batch) -> dict[str, float]:
    truth, known = level_heights(batch)
    error = (levels.height - truth).abs()
    return {n: float(error[known[:, i], i].mean()) for i, n in enumerate(("floor_m", "ceiling_m"))}


def level_heights(batch: Batch) -> tuple[Tensor, Tensor]:
    """Heights (B, 2) of floor, as tilted, and ceiling at the camera's foot point; known (B, 2)."""
    level = batch["level_plane"]
    planes = batch["plane"].gather(1, level.clamp(min=0)[..., None].expand(-1, -1, 4))
    height = planes[..., 2] * planes[..., 3]
    return torch.stack([batch["floor"][:, 0], height[:, 1]], dim=1), level >= 0


def point_centres(batch: Batch) -> tuple[Tensor, Tensor]:
    """Centres (B, N, 3) of the points' planes and where they are known (B, N)."""
    label = batch["point_plane"].clamp(min=0)
    centre = batch["plane_centre"].gather(1, label[..., None].expand(-1, -1, 3))
    known = batch["plane_known"].gather(1, label) & (batch["point_plane"] >= 0)
    return centre, known


def point_figures(points: PointPrediction, batch: Batch) -> dict[str, float]:
    """Of the points: median angle of the normals, given and predicted, accuracy of the classes,
    and the share of centres within 0.3 m."""
    valid = batch["valid"] & (batch["point_class"] > 0)
    centre, on = point_centres(batch)
    error = (batch["points"] + points.offset - centre).norm(dim=-1)
    known = batch["normals"].norm(dim=-1) > 0.5
    return {
        "normal_median_deg": _median_angle(points.normal, batch, valid),
        "given_normal_median_deg": _median_angle(batch["normals"], batch, valid & known),
        "class_accuracy": mean_of(points.semantics.argmax(dim=-1) == batch["point_class"], valid),
        "centre_within_30cm": mean_of(error < 0.3, on & valid),
    }


def _median_angle(normals: Tensor, batch: Batch, where: Tensor) -> float:
    cosine = (normals * batch["point_normal"]).sum(dim=-1)[where].clamp(-1.0, 1.0)
    return float(torch.rad2deg(cosine.acos()).median()) if len(cosine) else math.nan


def mean_of(values: Tensor, where: Tensor) -> float:
    """Share of ``values`` among ``where``; not a number where there is nothing to count."""
    return float(values[where].float().mean())
