"""Cells of the completed layout that something stands on as features."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from fewview.completion import room_matches
from fewview.completion.kinds import ScanView, no_features
from fewview.completion.layout.grid import DOOR, FREE, FURNITURE, WALL, cell_centres
from fewview.config import FeatureConfig
from fewview.geometry import se3
from fewview.types import (
    Array,
    CompletedLayout,
    CompletedScan,
    Correspondences,
    FeatureSet,
    FloatArray,
    Representation,
    Scales,
)

THINGS = (WALL, FURNITURE, DOOR)
HEIGHT_M = 1.0
BLUR_CELLS = 1.5
MIN_SLOPE = 0.05
MAX_FEATURES = 240
MAX_CORRESPONDENCES = 400
SCALES = Scales(0.206, 1.60, 0.73, 0.05, fixed_point=False)


class Layout:
    """Walls, doors and furniture from above; they face the free floor beside them."""

    name = "layout"
    representation = Representation.LAYOUT

    def extract(self, view: ScanView, config: FeatureConfig) -> FeatureSet:
        layout = view.room.layout
        if layout is None:
            return no_features(self)
        at = chosen_cells(layout)
        scan_T_level = se3.inverse(layout.level_T_scan)
        return FeatureSet(
            self.name,
            self.representation,
            se3.transform(scan_T_level, places(layout)[at]),
            se3.rotate(scan_T_level, facing(layout)[at]),
            room_matches.described(layout.descriptors[at], layout.probabilities[:, *at].T),
            layout.observed[at],
            layout.confidence[at],
        )

    def correspond(self, source: CompletedScan, target: CompletedScan) -> Correspondences:
        return room_matches.correspond(self, source, target, SCALES, MAX_CORRESPONDENCES)


def chosen_cells(layout: CompletedLayout) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the surest cells that are a wall, a door or furniture; of each two
    neighbours in a row one, as on a chessboard."""
    things = np.isin(layout.classes, THINGS)
    things &= np.indices(things.shape).sum(axis=0) % 2 == 0
    score = np.where(things, layout.confidence, 0.0)
    best = np.argsort(-score, axis=None, kind="stable")[: min(MAX_FEATURES, int(things.sum()))]
    rows, columns = np.unravel_index(np.sort(best), score.shape)
    return rows, columns


def places(layout: CompletedLayout) -> Array:
    """(G, G, 3) points over the cells' centres `HEIGHT_M` above the floor, level frame."""
    centres = cell_centres().astype(np.float64)
    *slope, upwards = layout.floor[:3]
    height = HEIGHT_M + (layout.floor[3] - centres @ np.array(slope)) / upwards
    return np.concatenate([centres, height[..., None]], axis=-1)


def facing(layout: CompletedLayout) -> Array:
    """(G, G, 3) horizontal unit vectors towards free floor, level frame; zero where it is even."""
    free: FloatArray = ndimage.gaussian_filter(layout.probabilities[FREE], BLUR_CELLS)
    along_x, along_y = np.gradient(-free)
    slope = np.stack([along_x, along_y], axis=-1)
    length = np.linalg.norm(slope, axis=-1, keepdims=True)
    unit = np.where(length > MIN_SLOPE, slope / np.maximum(length, MIN_SLOPE), 0.0)
    return np.pad(unit.astype(np.float64), ((0, 0), (0, 0), (0, 1)))
