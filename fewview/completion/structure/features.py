"""The walls, floor and ceiling of the completed room as features."""

from __future__ import annotations

import numpy as np

from fewview.completion import room_matches
from fewview.completion.kinds import ScanView, no_features
from fewview.config import FeatureConfig
from fewview.geometry import se3
from fewview.types import (
    CompletedScan,
    Correspondences,
    FeatureSet,
    Representation,
    Scales,
)

KINDS = ("floor", "ceiling", "wall")
MAX_CORRESPONDENCES = 60
SCALES = Scales(0.143, 0.80, 0.21, 0.50, fixed_point=False)


class Structure:
    """Structural planes with the middle of the whole plane for a position."""

    name = "structure"
    representation = Representation.PLANES

    def extract(self, view: ScanView, config: FeatureConfig) -> FeatureSet:
        completed = view.room.planes
        if completed is None:
            return no_features(self)
        planes = completed.planes
        scan_T_level = se3.inverse(view.room.level_T_scan)
        called = np.array([[p.kind == kind for kind in KINDS] for p in planes], np.float32)
        return FeatureSet(
            self.name,
            self.representation,
            se3.transform(scan_T_level, np.array([p.centre for p in planes])),
            se3.rotate(scan_T_level, np.array([p.normal for p in planes])),
            room_matches.described(np.array([p.descriptor for p in planes]), called),
            np.array([p.observed for p in planes]),
            np.array([p.confidence for p in planes], np.float32),
        )

    def correspond(self, source: CompletedScan, target: CompletedScan) -> Correspondences:
        return room_matches.correspond(self, source, target, SCALES, MAX_CORRESPONDENCES)
