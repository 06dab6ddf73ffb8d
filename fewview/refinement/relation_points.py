"""The points of one scan as the relation network reads them (supplementary, "Local Relation
Network"): of its surface and of what the 360-image network predicts around it.

Their frame is the level frame of the completed room: camera at the origin, z up, axes along the
walls that the scan shows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fewview.completion.panorama.ring import ring_pixels, ring_points
from fewview.geometry import se3
from fewview.types import (
    Array,
    BoolArray,
    CompletedPanorama,
    CompletedScan,
    FloatArray,
    IntArray,
)

SEEN, PREDICTED = 768, 256
"""Points of a scan that the network looks at."""
OUTSIDE = -1
"""Pixel of points above or below the ring."""
GREY = 0.5
"""What stands for the colour of predicted points, which have none."""
MIN_COSINE = 0.2
NOBODY = np.zeros(0, np.int64)
RGB_OF_XYZ = np.array(
    [
        [3.240479, -1.53715, -0.498535],
        [-0.969256, 1.875991, 0.041556],
        [0.055648, -0.204043, 1.057311],
    ]
)
WHITE = np.array([0.950456, 1.0, 1.088754])


@dataclass(frozen=True)
class RelationPoints:
    """Points of one scan.

    Attributes:
        points: (n, 3) float32 level frame, metres.
        normals: (n, 3) float32 unit, level frame, towards the camera.
        colours: (n, 3) float32 RGB in 0..1, `GREY` where predicted.
        confidence: (n,) float32 in 0..1, 1 where seen.
        predicted: (n,) bool.
        pooled: (n,) bool, points that say how the scan looks as a whole; the others are only
            asked about.
        pixels: (n,) flat pixel of the ring that shows each point, or `OUTSIDE`.
        ring_colour: (S, 4 S, 3), ring_depth: (S, 4 S) metres: the ring of what was seen.
    """

    points: FloatArray
    normals: FloatArray
    colours: FloatArray
    confidence: FloatArray
    predicted: BoolArray
    pooled: BoolArray
    pixels: IntArray
    ring_colour: NDArray[np.uint8]
    ring_depth: FloatArray


def relation_points(
    scan: CompletedScan, rng: np.random.Generator, asked: IntArray = NOBODY
) -> RelationPoints:
    """The surface points that are asked about, then an even sample of the surface (`SEEN` at most)
    and `PREDICTED` points of the completed 360-image, if there is one.

    Args:
        scan: the scan.
        rng: chooses the predicted points.
        asked: (m,) indices of surface points; rows 0..m-1 of the answer are theirs.
    """
    level_T_scan, ring = scan.room.level_T_scan, scan.room.ring
    index = np.concatenate([asked, even(len(scan.surface.points), SEEN)])
    seen = se3.transform(level_T_scan, scan.surface.points[index])
    turned = se3.rotate(level_T_scan, scan.surface.normals[index])
    pixel, _, inside = ring_pixels(seen, len(ring.depth))
    further, shown = _predicted(scan.room.panorama, rng)
    count = len(further)
    return RelationPoints(
        points=_joined(seen, shown[:, :3]),
        normals=_joined(turned, shown[:, 3:6]),
        colours=_joined(rgb_of_lab(scan.surface.colours[index]), np.full((count, 3), GREY)),
        confidence=_joined(np.ones(len(index)), shown[:, 6]),
        predicted=np.arange(len(index) + count) >= len(index),
        pooled=np.arange(len(index) + count) >= len(asked),
        pixels=np.concatenate([np.where(inside, pixel, OUTSIDE), further]),
        ring_colour=ring.colour,
        ring_depth=ring.depth,
    )


def even(count: int, most: int) -> IntArray:
    """At most ``most`` of the numbers below ``count``, evenly spread."""
    return np.linspace(0, count - 1, min(count, most)).astype(np.int64)


def predicted_pixels(panorama: CompletedPanorama, count: int, rng: np.random.Generator) -> IntArray:
    """(count,) flat pixels that were not measured, drawn evenly over the predicted surface and
    the more often the surer the prediction is; none where everything was measured."""
    weight = panorama.confidence * pixel_area(ring_points(panorama.depth), panorama.normals)
    return drawn(np.where(panorama.observed, 0.0, weight), count, rng)


def drawn(weight: Array, count: int, rng: np.random.Generator) -> IntArray:
    """``count`` flat indices drawn in proportion to weights; none where all are 0."""
    total = float(weight.sum())
    if total == 0.0:
        return NOBODY
    return np.asarray(rng.choice(weight.size, count, p=weight.ravel() / total), np.int64)


def pixel_area(points: FloatArray, normals: FloatArray) -> Array:
    """(...) area of the surface that a ring's pixels show, up to one factor for all.

    Args:
        points: (..., 3) what they show, level frame.
        normals: (..., 3) unit.
    """
    distance = np.maximum(np.linalg.norm(points, axis=-1), 1e-6).astype(np.float64)
    cosine = np.abs((points * normals).sum(axis=-1)) / distance
    depth = np.abs(points[..., :2]).max(axis=-1)
    return np.asarray(depth**3 / (distance * np.maximum(cosine, MIN_COSINE)))


def rgb_of_lab(lab: FloatArray) -> Array:
    """(n, 3) CIE Lab as OpenCV has it (D65) to sRGB in 0..1; the inverse of its conversion."""
    values = lab.astype(np.float64)
    fy = (values[:, 0] + 16.0) / 116.0
    f = np.stack([fy + values[:, 1] / 500.0, fy, fy - values[:, 2] / 200.0], axis=1)
    linear = np.where(f > 6.0 / 29.0, f**3, (f - 16.0 / 116.0) / 7.787) * WHITE @ RGB_OF_XYZ.T
    linear = linear.clip(0.0, 1.0)
    curved = 1.055 * linear ** (1.0 / 2.4) - 0.055
    return np.asarray(np.where(linear > 0.0031308, curved, 12.92 * linear))


def _predicted(
    panorama: CompletedPanorama | None, rng: np.random.Generator
) -> tuple[IntArray, Array]:
    """Flat pixels (n,) of predicted points, and point, normal and confidence (n, 7) of each."""
    if panorama is None:
        return NOBODY, np.zeros((0, 7))
    pixels = predicted_pixels(panorama, PREDICTED, rng)
    parts = (ring_points(panorama.depth), panorama.normals, panorama.confidence[..., None])
    every = np.concatenate(parts, axis=-1).reshape(-1, 7)
    return pixels, every[pixels].astype(np.float64)


def _joined(seen: Array, predicted: Array) -> FloatArray:
    return np.concatenate([seen, predicted]).astype(np.float32)
