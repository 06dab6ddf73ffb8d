"""Poses that two completed rooms propose: the second spectral pass, between levelled scans."""

from __future__ import annotations

from fewview.completion.room_matches import floor_height
from fewview.matching.consistency import CandidateMatches, consistency_matrix
from fewview.matching.spectral import top_poses
from fewview.types import Array, CompletedScan


def completion_poses(
    source: CompletedScan, target: CompletedScan, matches: CandidateMatches, count: int
) -> list[tuple[Array, float]]:
    """Up to ``count`` poses target_T_source and their spectral scores, best first.

    Args:
        source, target: the scans.
        matches: between their completed rooms, stacked as levelled.
        count: how many.

    Returns:
        poses under which the scans' verticals agree and, when both are known, their floors meet.
    """
    return [
        (_floors_met(source, target, hypothesis.target_T_source), hypothesis.score)
        for hypothesis in top_poses(matches, consistency_matrix(matches), count)
    ]


def _floors_met(source: CompletedScan, target: CompletedScan, target_T_source: Array) -> Array:
    """A levelled pose shifted along the vertical until the floors meet."""
    floors = floor_height(source), floor_height(target)
    if floors[0] is None or floors[1] is None:
        return target_T_source
    up = target.levelling.level_R_scan[2]
    met = target_T_source.copy()
    met[:3, 3] += (floors[1] - floors[0] - met[:3, 3] @ up) * up
    return met
