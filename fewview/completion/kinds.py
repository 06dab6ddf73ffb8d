"""What one kind of feature has to offer; a new kind is one new file and one entry in `KINDS`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fewview.completion.local_geometry import DepthView
from fewview.config import FeatureConfig
from fewview.geometry.camera import lift
from fewview.types import (
    CompletedRoom,
    CompletedScan,
    Correspondences,
    FeatureSet,
    FloatArray,
    Frame,
    Levelling,
    PlanarPatch,
    Representation,
    Scales,
    Surface,
)

MIN_DEPTHS = 2


@dataclass(frozen=True)
class ScanView:
    """What an extractor may look at: one scan's pixels and what was made of them."""

    frame: Frame
    quarter_turns: int
    depth: DepthView
    surface: Surface
    patches: tuple[PlanarPatch, ...]
    levelling: Levelling
    room: CompletedRoom


class FeatureKind(Protocol):
    """Extracts one kind of feature from a scan and matches it between two scans."""

    name: str
    representation: Representation

    def extract(self, view: ScanView, config: FeatureConfig) -> FeatureSet:
        """Features of one scan."""

    def correspond(self, source: CompletedScan, target: CompletedScan) -> Correspondences:
        """Candidate correspondences between this kind's features of two scans."""


def keypoint_features(
    kind: FeatureKind,
    view: ScanView,
    pixels: FloatArray,
    descriptors: FloatArray,
    confidence: FloatArray,
    config: FeatureConfig,
    limit: int,
) -> FeatureSet:
    """Give image keypoints a position and, where the surface allows, a normal.

    Args:
        kind: whose features they are.
        view: the scan.
        pixels: (n, 2) x, y in the full image, best first; descriptors: (n, d); confidence: (n,).
        config: keypoints beyond its depth range, or without depth, are not kept.
        limit: how many are kept.
    """
    depth = view.frame.depth
    columns = np.clip(np.rint(pixels[:, 0]).astype(int), 0, depth.shape[1] - 1)
    rows = np.clip(np.rint(pixels[:, 1]).astype(int), 0, depth.shape[0] - 1)
    z = _smoothed_depth(depth, rows, columns)
    kept = np.flatnonzero((z > 0) & (z < config.max_depth_m))[:limit]
    pixels = pixels[kept]
    normals, reliable = view.depth.normals(*view.depth.pixels_of(pixels, view.frame.intrinsics))
    return FeatureSet(
        kind.name,
        kind.representation,
        lift(pixels, z[kept], view.frame.intrinsics),
        np.where(reliable[:, None], normals, 0.0),
        descriptors[kept],
        np.ones(len(kept), dtype=bool),
        confidence[kept],
        pixels,
    )


def no_features(kind: FeatureKind) -> FeatureSet:
    """What a kind extracts from a scan that shows nothing."""
    nothing, vectors = np.zeros(0, np.float32), np.zeros((0, 3))
    return FeatureSet(
        kind.name,
        kind.representation,
        vectors,
        vectors,
        np.zeros((0, 1), np.float32),
        nothing.astype(bool),
        nothing,
    )


def no_correspondences(kind: FeatureKind, scales: Scales) -> Correspondences:
    """What a kind answers when one of the scans has too few of its features."""
    return Correspondences(kind.name, np.zeros((0, 2), np.int64), np.zeros(0, np.float32), scales)


def _smoothed_depth(depth: FloatArray, rows: np.ndarray, columns: np.ndarray) -> FloatArray:
    """Median of the valid depths in the 5 x 5 pixels around each keypoint; at a jump in depth
    the nearer side, since corners seen by a camera belong to the occluding surface."""
    padded = np.pad(depth, 2)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (5, 5))[rows, columns]
    values = windows.reshape(len(rows), 25)
    valid = values > 0
    nearest = np.where(valid, values, np.inf).min(axis=1, initial=np.inf)
    near_side = valid & (values < 1.05 * nearest[:, None])
    ordered = np.sort(np.where(near_side, values, np.inf), axis=1)
    count = near_side.sum(axis=1)
    middle = np.take_along_axis(ordered, np.maximum(count - 1, 0)[:, None] // 2, axis=1)[:, 0]
    return np.where(count >= MIN_DEPTHS, middle, 0).astype(np.float32)
