"""Poses that two completed rooms propose: the second spectral pass, between levelled scans."""

from __future__ import annotations

from fewview.matching.consistency import CandidateMatches, consistency_matrix
from fewview.matching.heights import lifted
from fewview.matching.spectral import top_poses
from fewview.types import Array, CompletedScan


def completion_poses(
    target: CompletedScan, matches: CandidateMatches, source_lift: float, count: int
) -> list[tuple[Array, float]]:
    """Up to ``count`` poses target_T_source and their spectral scores, best first.

    Args:
        target: the scan.
        matches: of the completed rooms, stacked as levelled.
        source_lift: see `heights.lift`.
        count: how many.

    Returns:
        poses under which the scans' verticals agree, with this lift.
    """
    return [
        (lifted(hypothesis.target_T_source, target, source_lift), hypothesis.score)
        for hypothesis in top_poses(matches, consistency_matrix(matches), count)
    ]
