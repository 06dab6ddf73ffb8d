"""A scan and the completed room around it drawn from above, on the grid of the completed layout."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from fewview.completion.layout.grid import CELLS, UNKNOWN, cells_of
from fewview.completion.panorama.ring import ring_points
from fewview.completion.panorama.walls import seen_normals
from fewview.types import Array, BoolArray, CompletedLayout, FloatArray, RingScan

CHANNELS = 17
PREDICTED = slice(0, 4)
OBSERVED = 4
SHOWN = slice(5, 10)
UPRIGHT_COLOURS = slice(10, 14)
LEVEL_COLOURS = slice(14, CHANNELS)
UPRIGHT_COS = 0.35
LEVEL_COS = 0.9
EYE_BAND_M = (0.15, 1.2)
FLOOR_TOP_M = 0.15
TABLE_BAND_M = (0.3, 1.5)
ENOUGH_POINTS = 4.0
LAB_SCALE = 40.0
HEIGHT_SCALE_M = 2.0


@dataclass(frozen=True)
class Drawing:
    """One scan from above.

    Attributes:
        channels: (CHANNELS, CELLS, CELLS) float32: the completed layout's probabilities of wall,
            free floor, furniture and door; where anything was observed; how densely it saw upright
            faces below and above 1.2 m, table tops, the floor; the height of the highest thing;
            mean Lab of upright faces and how uneven their lightness is; mean Lab of faces that
            look up.
        level_T_scan: (4, 4) into the frame of the grid; see `completion.layout.grid`.
        floor_z: height of the floor there.
    """

    channels: FloatArray
    level_T_scan: Array
    floor_z: float


def draw(ring: RingScan, layout: CompletedLayout) -> Drawing:
    """Draw a scan whose layout was completed."""
    floor_z = layout.floor_z
    turn = (layout.level_T_scan[:3, :3] @ ring.level_T_scan[:3, :3].T).astype(np.float32)
    seen = ring.depth > 0
    points = ring_points(ring.depth)[seen] @ turn.T
    normals = seen_normals(ring.depth)[seen] @ turn.T
    lab = _lab(ring.colour[seen])
    cell, inside = (found.numpy() for found in cells_of(torch.from_numpy(points)))
    flat, height = cell[inside], points[inside, 2] - floor_z
    normals, lab = normals[inside], lab[inside]
    upright, up = np.abs(normals[:, 2]) < UPRIGHT_COS, normals[:, 2] > LEVEL_COS
    kinds = (
        upright & (height > EYE_BAND_M[0]) & (height < EYE_BAND_M[1]),
        upright & (height >= EYE_BAND_M[1]),
        up & (height > TABLE_BAND_M[0]) & (height < TABLE_BAND_M[1]),
        up & (np.abs(height) < FLOOR_TOP_M),
    )
    density = [np.minimum(_summed(flat, kind) / ENOUGH_POINTS, 1.0) for kind in kinds]
    top = np.zeros(CELLS * CELLS)
    np.maximum.at(top, flat, height / HEIGHT_SCALE_M)
    *faces, light_squared = _means(flat, upright, np.column_stack([lab, lab[:, 0] ** 2]))
    uneven = np.sqrt(np.maximum(light_squared - faces[0] ** 2, 0.0))
    colours = [*faces, uneven, *_means(flat, up, lab)]
    shown = np.stack([*density, np.minimum(top, 2.0), *colours]).reshape(-1, CELLS, CELLS)
    predicted = np.delete(layout.probabilities, UNKNOWN, axis=0)
    channels = np.concatenate([predicted, layout.observed[None], shown], dtype=np.float32)
    return Drawing(channels, layout.level_T_scan, floor_z)


def _means(cell: NDArray[np.int64], kind: BoolArray, values: FloatArray) -> list[Array]:
    """(CELLS^2,) of each column of ``values``, over the points of a kind."""
    count = np.maximum(_summed(cell, kind), 1.0)
    return [_summed(cell, kind * column) / count for column in values.T]


def _summed(cell: NDArray[np.int64], weight: NDArray[np.generic]) -> Array:
    return np.asarray(np.bincount(cell, weight.astype(np.float64), CELLS * CELLS))


def _lab(colours: NDArray[np.uint8]) -> FloatArray:
    """(n, 3) RGB to CIE Lab about mid grey, of the order of one."""
    if not len(colours):
        return np.zeros((0, 3), np.float32)
    lab = cv2.cvtColor(colours[None].astype(np.float32) / 255.0, cv2.COLOR_RGB2LAB)[0]
    return np.asarray((lab - [50.0, 0.0, 0.0]) / LAB_SCALE, dtype=np.float32)
