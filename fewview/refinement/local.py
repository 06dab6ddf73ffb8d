"""The local module (Sec. 3.3): poses that are about right to better ones.

Relations are predicted under the poses, then the robust regression moves them. What a regression
can follow ends where the surfaces that both scans saw do not meet. A pose that comes from outside
is therefore refined twice, from where it is and from where the completed rooms lie over each other
near it, and what both scans saw decides; where that is next to nothing, the second start stays.
"""

from __future__ import annotations

import numpy as np

from fewview.config import RefinementConfig
from fewview.matching.heights import lift, lifted
from fewview.matching.prepared import PreparedScan, aligned
from fewview.refinement.evidence import visible_agreement
from fewview.refinement.learned_relations import LearnedRelations
from fewview.refinement.regression import Matches, Refined, refine
from fewview.refinement.relations import PatchRelations, RelationPredictor
from fewview.types import Array

MIN_AGREEMENT = 0.1
CONTRADICTION = 2.0
"""What a point in seen free space counts against one on the surface."""


def refine_related(
    source: PreparedScan,
    target: PreparedScan,
    target_T_source: Array,
    matches: Matches,
    config: RefinementConfig,
) -> Refined:
    """Predict relations under (K, 4, 4) poses, by the network for completed scans, and refine.

    Args:
        source, target: the scans.
        target_T_source: (K, 4, 4).
        matches: features that agree with each pose.
        config: scales and iteration counts.
    """
    completed = source.scan.room.completed and target.scan.room.completed
    predictor: RelationPredictor = LearnedRelations() if completed else PatchRelations()
    return refine(
        (source.scan.surface, source.tree),
        (target.scan.surface, target.tree),
        target_T_source,
        predictor.predict(source.scan, target.scan, target_T_source),
        matches,
        config,
    )


def refine_alone(
    source: PreparedScan, target: PreparedScan, target_T_source: Array, config: RefinementConfig
) -> Array:
    """(K, 4, 4) poses from anywhere, refined without any matched features."""
    settled = _settled(source, target, target_T_source, config.settle_m)
    starts = np.concatenate([target_T_source, settled])
    nothing = np.zeros((0, 3))
    matches = Matches(nothing, nothing, np.zeros((len(starts), 0)))
    refined = refine_related(source, target, starts, matches, config).target_T_source
    visible = visible_agreement(source, target, refined)
    agreement = (visible.on_surface - CONTRADICTION * visible.in_front).reshape(2, -1)
    best, each = agreement.argmax(axis=0), np.arange(len(settled))
    believed = agreement[best, each] > MIN_AGREEMENT
    chosen = refined.reshape(2, -1, 4, 4)[best, each]
    return np.where(believed[:, None, None], chosen, settled)


def _settled(
    source: PreparedScan, target: PreparedScan, target_T_source: Array, spread_m: float
) -> Array:
    """Where the completed rooms lie over each other near poses; the poses themselves without
    completed rooms."""
    alignment = aligned(source, target)
    if alignment is None:
        return target_T_source
    rise = lift(source.scan, target.scan, source.heights, target.heights)
    near = alignment.near(target_T_source, spread_m)
    return np.array([lifted(pose, target.scan, rise) for pose in near]).reshape(-1, 4, 4)
