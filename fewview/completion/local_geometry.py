"""Points and normals of a depth image, and the thinned surface made of them.

Normals are the smallest principal axis of the points in a window around a pixel (PCA); the
windowed moments come from box filters, so that only the pixels asked for cost an eigenproblem.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fewview.geometry.camera import backproject, depth_edges
from fewview.types import Array, BoolArray, FloatArray, Frame, Intrinsics, Surface

WINDOW_PX = 9
MIN_WINDOW_SHARE = 0.3
MAX_GRAZING_COS = 0.1


@dataclass(frozen=True)
class DepthView:
    """A reduced depth image with window moments for normals.

    Attributes:
        intrinsics: camera of the reduced image.
        depth: (h, w) float32, metres, 0 unknown, depth edges removed.
        points: (h, w, 3) float32.
        moments: (h, w, 10) float64: share of valid pixels, mean point, mean outer product (6).
    """

    intrinsics: Intrinsics
    depth: FloatArray
    points: FloatArray
    moments: Array

    @staticmethod
    def of(frame: Frame, max_depth_m: float, width: int = 320) -> DepthView:
        """Reduce a frame's depth to about ``width`` pixels and prepare normals."""
        step = max(1, round(frame.intrinsics.width / width))
        depth, intrinsics = reduce_depth(frame.depth, frame.intrinsics, step)
        depth = np.where((depth > 0) & (depth < max_depth_m), depth, np.float32(0))
        depth[depth_edges(depth)] = 0
        points = backproject(depth, intrinsics)
        return DepthView(intrinsics, depth, points, _window_moments(points, depth > 0))

    def normals(self, rows: np.ndarray, columns: np.ndarray) -> tuple[Array, BoolArray]:
        """Unit normals towards the camera at pixels, and which of them are reliable.

        Args:
            rows: (n,) pixel rows of the reduced image.
            columns: (n,) pixel columns.
        """
        m = self.moments[rows, columns]
        share = m[:, 0]
        reliable = share > MIN_WINDOW_SHARE
        safe = np.where(reliable, share, 1.0)[:, None]
        mean, second = m[:, 1:4] / safe, m[:, 4:] / safe
        covariance = second[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
        covariance = covariance - mean[:, :, None] * mean[:, None, :]
        covariance[~reliable] = np.eye(3)
        values, vectors = np.linalg.eigh(covariance)
        normals = vectors[:, :, 0]
        towards = -np.einsum("ni,ni->n", normals, mean)
        normals = normals * np.where(towards < 0, -1.0, 1.0)[:, None]
        distance = np.linalg.norm(mean, axis=1)
        reliable &= np.abs(towards) > MAX_GRAZING_COS * distance
        reliable &= values[:, 0] < 0.15 * values[:, 1]
        return normals, reliable

    def pixels_of(self, pixels: FloatArray, full: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns in the reduced image of (n, 2) pixels of the full one."""
        sx, sy = self.intrinsics.width / full.width, self.intrinsics.height / full.height
        columns = np.clip(((pixels[:, 0] + 0.5) * sx).astype(int), 0, self.intrinsics.width - 1)
        rows = np.clip(((pixels[:, 1] + 0.5) * sy).astype(int), 0, self.intrinsics.height - 1)
        return rows, columns


def reduce_depth(
    depth: FloatArray, intrinsics: Intrinsics, step: int
) -> tuple[FloatArray, Intrinsics]:
    """Keep one depth in ``step`` x ``step`` pixels: the median of the valid ones."""
    height, width = depth.shape[0] // step, depth.shape[1] // step
    if step == 1:
        return depth.copy(), intrinsics
    tiles = depth[: height * step, : width * step].reshape(height, step, width, step)
    blocks = tiles.transpose(0, 2, 1, 3).reshape(height, width, step * step)
    ordered = np.sort(np.where(blocks > 0, blocks, np.inf), axis=-1)
    count = (blocks > 0).sum(axis=-1)
    middle = np.take_along_axis(ordered, np.maximum(count - 1, 0)[..., None] // 2, axis=-1)
    reduced = np.where(count > 0, middle[..., 0], 0).astype(np.float32)
    camera = Intrinsics(
        width,
        height,
        intrinsics.fx / step,
        intrinsics.fy / step,
        (intrinsics.cx + 0.5) / step - 0.5,
        (intrinsics.cy + 0.5) / step - 0.5,
    )
    return reduced, camera


def thin_surface(view: DepthView, colour: NDArray[np.uint8], voxel_m: float) -> Surface:
    """One point a voxel with its normal and colour; labels are -1 until patches are found.

    Args:
        view: reduced depth with normals.
        colour: (H, W, 3) RGB of the full image.
        voxel_m: spacing of the points.
    """
    rows, columns = np.nonzero(view.depth > 0)
    points = view.points[rows, columns].astype(np.float64)
    keys = np.floor(points / voxel_m).astype(np.int64)
    keys -= keys.min(axis=0, initial=0)
    extent = keys.max(axis=0, initial=0) + 1
    flat = (keys[:, 0] * extent[1] + keys[:, 1]) * extent[2] + keys[:, 2]
    _, first, inverse, count = np.unique(
        flat, return_index=True, return_inverse=True, return_counts=True
    )
    sums = np.stack([np.bincount(inverse, points[:, i], len(first)) for i in range(3)], axis=1)
    means = sums / count[:, None]
    normals, reliable = view.normals(rows[first], columns[first])
    size = (view.intrinsics.width, view.intrinsics.height)
    small = cv2.resize(colour, size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255.0
    lab = cv2.cvtColor(small, cv2.COLOR_RGB2LAB)[rows[first], columns[first]]
    labels = np.full(int(reliable.sum()), -1, dtype=np.int64)
    return Surface(means[reliable], normals[reliable], lab[reliable], labels)


def _window_moments(points: FloatArray, valid: BoolArray) -> Array:
    p = points.astype(np.float64)
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    stack = np.stack([valid.astype(np.float64), x, y, z, x * x, x * y, x * z, y * y, y * z, z * z])
    stack[:, ~valid] = 0.0
    size = (WINDOW_PX, WINDOW_PX)
    smooth = [cv2.boxFilter(c, cv2.CV_64F, size, borderType=cv2.BORDER_CONSTANT) for c in stack]
    return np.stack(smooth, axis=-1)
