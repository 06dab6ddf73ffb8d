"""Walls, floors and ceilings that several scans show, also where they show different parts.

Every two scans that show a plane hold each other by it; a landmark of the plane, eliminated, would
do the same.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from fewview.geometry import se3
from fewview.global_stage.normal_equations import Facing
from fewview.types import Array, CompletedScan

LEAST_POINTS = 400
"""Smaller patches are as often furniture, which stands askew and nearly level with other things."""

SAME_NORMAL_COS = math.cos(math.radians(10.0))
"""Planes of normals further apart are different ones ..."""

SAME_OFFSET_M = 0.1
"""... and so are those further apart than this."""

NORMAL_SIGMA = math.radians(1.0)
"""Standard deviation between the normals of one plane in two scans."""

OFFSET_SIGMA_M = 0.03
"""The same of its place."""


@dataclass(frozen=True)
class Planes:
    """Large planar patches of a scan: (n, 3) centres and unit normals in its frame."""

    centres: Array
    normals: Array

    @staticmethod
    def of(scan: CompletedScan) -> Planes:
        """The patches of a scan that are large enough."""
        large = [patch for patch in scan.patches if patch.count >= LEAST_POINTS]
        return Planes(
            np.array([patch.centre for patch in large]).reshape(-1, 3),
            np.array([patch.normal for patch in large]).reshape(-1, 3),
        )


def shared(planes: Sequence[Planes], poses: Array, scale: float) -> Iterator[Facing]:
    """The planes that each two scans have in common under (m, 4, 4) poses.

    Their centres are held to each other's planes; the further apart they are, the less, as a
    plane's normal is known only so well.

    Args:
        planes: of m scans.
        poses: world_T_scan.
        scale: of the loss, metres.
    """
    for i, j in itertools.combinations(range(len(planes)), 2):
        ours, theirs = planes[i], planes[j]
        a, b = np.divmod(np.arange(len(ours.centres) * len(theirs.centres)), len(theirs.centres))
        n, m = se3.rotate(poses[i], ours.normals)[a], se3.rotate(poses[j], theirs.normals)[b]
        gap = se3.transform(poses[i], ours.centres)[a] - se3.transform(poses[j], theirs.centres)[b]
        offset = np.maximum(np.abs((gap * n).sum(axis=1)), np.abs((gap * m).sum(axis=1)))
        same = ((n * m).sum(axis=1) > SAME_NORMAL_COS) & (offset < SAME_OFFSET_M)
        a, b, apart = a[same], b[same], np.square(gap[same]).sum(axis=1)
        yield Facing(
            source=i,
            target=j,
            p=ours.centres[a],
            n_p=ours.normals[a],
            q=theirs.centres[b],
            n_q=theirs.normals[b],
            information=1.0 / (OFFSET_SIGMA_M**2 + NORMAL_SIGMA**2 * apart),
            scale=scale,
        )
