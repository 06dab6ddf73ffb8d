"""What speaks for and against refined poses: agreement, contradiction, gravity, free space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from fewview.alignment import Alignment
from fewview.geometry import se3
from fewview.geometry.camera import project
from fewview.matching.consistency import CandidateMatches
from fewview.matching.prepared import NEAR_M, PreparedScan
from fewview.refinement.room_evidence import room_evidence
from fewview.refinement.support import Support
from fewview.types import (
    Array,
    BoolArray,
    CandidateOrigin,
    Evidence,
    IntArray,
    Levelling,
)

MAX_POINTS = 1200
VISIBLE_TOLERANCE_M = 0.05
VISIBLE_TOLERANCE_RELATIVE = 0.02
FEW_POINTS = 6.0
COLOUR_NOISE = 30.0
"""Variance of the colour of one place, seen twice, over the three channels of Lab."""
PROPOSED_FROM_ABOVE = (
    CandidateOrigin.COMPLETION,
    CandidateOrigin.ALIGNMENT,
    CandidateOrigin.MANHATTAN,
)


def gather(
    source: PreparedScan,
    target: PreparedScan,
    poses: Array,
    covariance: Array,
    matches: CandidateMatches,
    support: BoolArray,
    origins: Sequence[CandidateOrigin],
    scores: Array,
    alignment: Alignment | None = None,
) -> list[Evidence]:
    """Evidence for K different poses of a pair.

    Args:
        source, target: the scans.
        poses: (K, 4, 4) target_T_source; covariance: (K, 6, 6) of each.
        matches: (m) candidate correspondences; support: (K, m) which agree with each pose.
        origins, scores: where each pose came from and its score there.
        alignment: of the pair's completed layouts.
    """
    surface = surface_agreement(source, target, poses)
    visible = visible_agreement(source, target, poses)
    tilt, floor_gap = gravity_disagreement(source.scan.levelling, target.scan.levelling, poses)
    yaw = yaw_disagreement(source.scan.levelling, target.scan.levelling, poses)
    features = Support.of(matches, support)
    geometry_alone = np.exp(-features.points / FEW_POINTS)
    columns = {
        **features.columns,
        "overlap": surface.overlap,
        "residual": surface.residual_m,
        "colour": surface.colour_gap,
        "concordance": surface.concordance,
        "visible": np.log1p(visible.count),
        "on_surface": visible.on_surface,
        "violation": np.sqrt(visible.in_front),
        "upright": visible.upright_on_surface,
        "upright_seen": np.log1p(visible.upright_count),
        "looseness": _looseness(covariance),
        "tilt": np.minimum(tilt, 0.35),
        "floor_gap": np.minimum(floor_gap, 0.5),
        "yaw": yaw,
        "facing": poses[:, 2, 2],
        **{o.value: np.array([x is o for x in origins], dtype=float) for o in PROPOSED_FROM_ABOVE},
    }
    columns["raster"] = columns["manhattan"] * scores / 100.0
    for name in ("overlap", "upright", "violation", "looseness", "colour", "concordance", "facing"):
        columns[f"alone_{name}"] = geometry_alone * columns[name]
    for name, values in room_evidence(source, target, poses, alignment).items():
        columns |= {name: values, f"alone_{name}": geometry_alone * values}
    return [
        Evidence(
            float(surface.residual_m[k]),
            float(surface.overlap[k]),
            float(visible.in_front[k]),
            features.by_representation(k),
            {name: float(values[k]) for name, values in columns.items()},
        )
        for k in range(len(poses))
    ]


@dataclass(frozen=True)
class SurfaceAgreement:
    """How two surfaces meet under K poses.

    Attributes:
        overlap: (K,) share of the smaller surface with a neighbour within 0.08 m facing alike.
        residual_m: (K,) mean point-to-plane distance of these neighbours.
        colour_gap: (K,) their mean difference in Lab after equal exposure, in units of 20.
        concordance: (K,) how far what is light, dark or coloured in one is so in the other: Lin's
            coefficient of concordance of their colours after equal exposure, which noise brings to
            0 where colours hardly vary. Surfaces of another place fit as well as the right ones
            where both are flat; their pattern does not.
    """

    overlap: Array
    residual_m: Array
    colour_gap: Array
    concordance: Array


def surface_agreement(source: PreparedScan, target: PreparedScan, poses: Array) -> SurfaceAgreement:
    """Compare nearest surface points both ways under (K, 4, 4) poses."""
    forward = _Meeting.of(source, target, poses)
    backward = _Meeting.of(target, source, se3.inverse(poses))
    smaller = forward
    if len(target.scan.surface.points) < len(source.scan.surface.points):
        smaller = backward
    count = forward.count + backward.count
    sums = (forward.sums + backward.sums).T
    residual, colour, product, squares = sums / np.maximum(count, 1)
    return SurfaceAgreement(
        smaller.share,
        np.where(count > 0, residual, NEAR_M),
        np.where(count > 0, colour, 1.0),
        2.0 * product / (squares + 2.0 * COLOUR_NOISE),
    )


@dataclass(frozen=True)
class _Meeting:
    """Points of one surface that meet the other.

    Attributes:
        share: (K,) of the sampled points; count: (K,) how many they are.
        sums: (K, 4) over them: distances from the other's planes, differences of colour, products
            and squares of both colours about their means.
    """

    share: Array
    count: IntArray
    sums: Array

    @staticmethod
    def of(moving: PreparedScan, fixed: PreparedScan, fixed_T_moving: Array) -> _Meeting:
        surface, other = moving.scan.surface, fixed.scan.surface
        step = max(1, len(surface.points) // MAX_POINTS)
        points = se3.transform(fixed_T_moving, surface.points[::step])
        pose, row = np.nonzero(fixed.vicinity.may_hold(points))
        distance, index = fixed.tree.query(points[pose, row], distance_upper_bound=NEAR_M)
        near = np.isfinite(distance)
        pose, row, index = pose[near], row[near], index[near]
        normal = np.einsum("nij,nj->ni", fixed_T_moving[pose, :3, :3], surface.normals[::step][row])
        alike = (normal * other.normals[index]).sum(axis=-1) > 0.7
        pose, row, index = pose[alike], row[alike], index[alike]
        begin = np.searchsorted(pose, np.arange(len(points) + 1))
        of_pose = csr_array(
            (np.ones(len(pose)), np.arange(len(pose)), begin), shape=(len(points), len(pose))
        )
        count = np.diff(begin)

        def centred(colours: Array) -> Array:
            mean = (of_pose @ colours) / np.maximum(count, 1)[:, None]
            return np.asarray(colours - mean[pose])

        offset = points[pose, row] - other.points[index]
        gap = np.abs((offset * other.normals[index]).sum(axis=-1))
        own, its = centred(surface.colours[::step][row]), centred(other.colours[index])
        difference = np.abs(own - its).mean(axis=-1) / 20.0
        product, squares = (own * its).sum(axis=-1), (own**2 + its**2).sum(axis=-1)
        each = np.stack([gap, difference, product, squares], axis=1)
        return _Meeting(count / max(points.shape[1], 1), count, of_pose @ each)


@dataclass(frozen=True)
class Visibility:
    """How the points of either scan fare in the other's depth image under K poses.

    Attributes:
        count: (K,) points that fall on measured pixels.
        on_surface: (K,) share of these on the measured surface.
        in_front: (K,) share of these in front of it, in space that was seen to be free.
        upright_count, upright_on_surface: the same for points on upright faces alone; floors and
            ceilings agree under any levelled pose.
    """

    count: Array
    on_surface: Array
    in_front: Array
    upright_count: Array
    upright_on_surface: Array


def visible_agreement(source: PreparedScan, target: PreparedScan, poses: Array) -> Visibility:
    """Look at each scan's points through the other's camera under (K, 4, 4) poses."""
    seen = _seen_by(target, se3.transform(poses, source.sample), source.sample_upright)
    inverse = se3.inverse(poses)
    seen += _seen_by(source, se3.transform(inverse, target.sample), target.sample_upright)
    count, on_surface, in_front, upright, upright_on = seen
    total = np.maximum(count, 1)
    return Visibility(
        count, on_surface / total, in_front / total, upright, upright_on / np.maximum(upright, 1)
    )


def _seen_by(scan: PreparedScan, points: Array, upright: BoolArray) -> Array:
    """(5, K) numbers of points (K, n, 3) that are measured, on the surface and in front of it, and
    of upright ones that are measured and on the surface."""
    pixels, inside = project(points, scan.scan.intrinsics)
    columns = np.where(inside, np.rint(pixels[..., 0]), 0).astype(int)
    rows = np.where(inside, np.rint(pixels[..., 1]), 0).astype(int)
    near, far, z = scan.depth_min[rows, columns], scan.depth_max[rows, columns], points[..., 2]
    measured = inside & (near > 0)
    tolerance = VISIBLE_TOLERANCE_M + VISIBLE_TOLERANCE_RELATIVE * z
    in_front = measured & (z < near - tolerance)
    on_surface = measured & ~in_front & (z < far + tolerance)
    kinds = (measured, on_surface, in_front, measured & upright, on_surface & upright)
    return np.stack([x.sum(axis=-1) for x in kinds]).astype(np.float64)


def gravity_disagreement(
    source: Levelling, target: Levelling, target_T_source: Array
) -> tuple[Array, Array]:
    """(K,) angle between the two scans' up directions under the poses, radians, and (K,) distance
    between their floors, metres, 0 where a floor is unknown."""
    turned = target_T_source[:, :3, :3] @ source.level_R_scan[2]
    tilt = np.arccos(np.clip(turned @ target.level_R_scan[2], -1.0, 1.0))
    if source.floor_z is None or target.floor_z is None:
        return tilt, np.zeros(len(tilt))
    lift = target_T_source[:, :3, 3] @ target.level_R_scan[2]
    return tilt, np.abs(source.floor_z + lift - target.floor_z)


def yaw_disagreement(source: Levelling, target: Levelling, target_T_source: Array) -> Array:
    """(K,) angle between the Manhattan frames modulo 90 degrees, 0 where one is unknown."""
    if not (source.manhattan and target.manhattan):
        return np.zeros(len(target_T_source))
    turned = target_T_source[:, :3, :3] @ source.level_R_scan[0]
    level = turned @ target.level_R_scan.T
    angle = np.arctan2(level[:, 1], level[:, 0])
    return np.asarray(np.abs((angle + np.pi / 4) % (np.pi / 2) - np.pi / 4))


def _looseness(covariance: Array) -> Array:
    """(K,) log10 of the largest standard deviation of the translation, in 0.1 mm, capped."""
    variance = np.linalg.eigvalsh(covariance[:, 3:, 3:])[:, -1]
    return np.asarray(np.clip(np.log10(np.sqrt(variance) / 1e-4), 0.0, 4.0))
