"""Small copies of what a recording shows: images, coloured points, match lines, light meshes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fewview.geometry import camera
from fewview.recording.rooms import RoomShape, room_shape
from fewview.types import (
    Array,
    BoolArray,
    ColouredMesh,
    CompletedScan,
    FeatureSet,
    FloatArray,
    Frame,
    IntArray,
    Intrinsics,
    Levelling,
)

Image = NDArray[np.uint8]

PREVIEW_WIDTH = 320
INPUT_WIDTH = 640
MAX_POINTS = 20_000
MAX_VERTICES = 250_000
MAX_MATCHES = 60


@dataclass(frozen=True)
class Preview:
    """What the recorder keeps of a scan until the poses are known.

    Attributes:
        name: the scan's name.
        colour: (h, w, 3) uint8 RGB, at most `PREVIEW_WIDTH` wide.
        depth: (h, w) float32, metres.
        intrinsics: the camera of both.
        points: (n, 3) thinned surface in the scan's frame, metres.
        point_colours: (n, 3) uint8 RGB.
        pixels: per feature kind, (n, 2) preview pixels of all features, NaN outside the image.
        levelling: how the scan stands.
        room: the room around it as completed.
    """

    name: str
    colour: Image
    depth: FloatArray
    intrinsics: Intrinsics
    points: Array
    point_colours: Image
    pixels: Mapping[str, FloatArray]
    levelling: Levelling
    room: RoomShape


def preview(frame: Frame, completed: CompletedScan) -> Preview:
    """Reduce one scan to what its pictures need."""
    small = reduced(frame, PREVIEW_WIDTH)
    stride = -(-len(completed.surface.points) // MAX_POINTS) or 1
    points = completed.surface.points[::stride]
    pixels = {k: _preview_pixels(f, frame, small) for k, f in completed.features.items()}
    return Preview(
        completed.name,
        small.colour,
        small.depth,
        small.intrinsics,
        points,
        _colours_of(points, small),
        pixels,
        completed.levelling,
        room_shape(completed.room),
    )


def reduced(frame: Frame, width: int) -> Frame:
    """A copy at most ``width`` pixels wide; depth is sampled, never averaged across edges."""
    rows, columns = frame.depth.shape
    scale = min(1.0, width / columns)
    size = (round(columns * scale), max(1, round(rows * scale)))
    colour = cv2.resize(frame.colour, size, interpolation=cv2.INTER_AREA)
    depth = cv2.resize(frame.depth, size, interpolation=cv2.INTER_NEAREST)
    return Frame(_bytes(colour), depth.astype(np.float32), frame.intrinsics.resized(*size))


def jpeg(colour: Image, quality: int = 85) -> bytes:
    """An RGB image as JPEG."""
    _, data = cv2.imencode(
        ".jpg",
        cv2.cvtColor(colour, cv2.COLOR_RGB2BGR),
        [cv2.IMWRITE_JPEG_QUALITY, quality],
    )
    return bytes(data)


def depth_png(depth: FloatArray) -> bytes:
    """A depth image in metres as 16-bit PNG in millimetres."""
    return _png(np.clip(np.nan_to_num(depth) * 1000.0, 0, 65535).round().astype(np.uint16))


def png(colour: Image) -> bytes:
    """An RGB image as PNG."""
    return _png(cv2.cvtColor(colour, cv2.COLOR_RGB2BGR))


def _png(values: NDArray[Any]) -> bytes:
    _, data = cv2.imencode(".png", values, [cv2.IMWRITE_PNG_COMPRESSION, 3])
    return bytes(data)


def side_by_side(source: Image, target: Image) -> Image:
    """Source on the left, target on the right, the lower one padded at the bottom."""
    height = max(len(source), len(target))
    padded = [np.pad(i, ((0, height - len(i)), (0, 0), (0, 0))) for i in (source, target)]
    return np.concatenate(padded, axis=1)


def match_lines(source: Preview, target: Preview, kind: str, matches: IntArray) -> FloatArray:
    """(m, 2, 2) segments across `side_by_side` for (n, 2) feature matches of one kind.

    Matches with an end outside its image are left out; at most `MAX_MATCHES`, evenly chosen.
    """
    start = source.pixels[kind][matches[:, 0]]
    end = target.pixels[kind][matches[:, 1]] + np.array(
        [source.intrinsics.width, 0], dtype=np.float32
    )
    lines = np.stack([start, end], axis=1)
    lines = lines[np.isfinite(lines).all(axis=(1, 2))]
    chosen = np.linspace(0, len(lines) - 1, min(len(lines), MAX_MATCHES)).astype(np.int64)
    return lines[chosen]


def light(mesh: ColouredMesh, limit: int = MAX_VERTICES) -> ColouredMesh:
    """The mesh itself, or one clustered to about ``limit`` vertices when it has more."""
    if len(mesh.vertices) <= limit:
        return mesh
    some = mesh.faces[:: max(1, len(mesh.faces) // 10_000)]
    edges = mesh.vertices[some[:, 0]] - mesh.vertices[some[:, 1]]
    cell = float(np.median(np.linalg.norm(edges, axis=1))) * np.sqrt(len(mesh.vertices) / limit)
    grid = ((mesh.vertices - mesh.vertices.min(axis=0)) / cell).astype(np.int64)
    key = np.ravel_multi_index(tuple(grid.T), tuple(grid.max(axis=0) + 1))
    _, cluster, counts = np.unique(key, return_inverse=True, return_counts=True)
    faces = cluster[mesh.faces]
    a, b, c = faces.T
    return ColouredMesh(
        _means(mesh.vertices, cluster, counts),
        faces[(a != b) & (b != c) & (c != a)],
        _bytes(_means(mesh.colours, cluster, counts)),
    )


def _means(values: NDArray[Any], cluster: IntArray, counts: IntArray) -> Array:
    return np.stack([np.bincount(cluster, v) / counts for v in values.T.astype(float)], axis=1)


def _bytes(values: NDArray[Any]) -> Image:
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


def _preview_pixels(features: FeatureSet, frame: Frame, small: Frame) -> FloatArray:
    projected, inside = camera.project(features.positions, frame.intrinsics)
    pixels = projected if features.pixels is None else features.pixels
    shown: BoolArray = inside if features.pixels is None else np.ones(len(features), dtype=bool)
    old, new = frame.intrinsics, small.intrinsics
    scale = np.array([new.width / old.width, new.height / old.height])
    scaled = (pixels + 0.5) * scale - 0.5
    return np.where(shown[:, None], scaled, np.nan).astype(np.float32)


def _colours_of(points: Array, frame: Frame) -> Image:
    pixels, inside = camera.project(points, frame.intrinsics)
    u, v = np.where(inside[:, None], np.round(pixels), 0).astype(np.int64).T
    grey = np.full((len(points), 3), 128, dtype=np.uint8)
    return np.where(inside[:, None], frame.colour[v, u], grey)
