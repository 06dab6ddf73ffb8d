"""The room around one scan in whichever of the three representations are asked for (Sec. 3.2)."""

from __future__ import annotations

from collections.abc import Container

import numpy as np

from fewview.completion import layout, panorama, structure
from fewview.types import CompletedRoom, Frame, Levelling

NETWORKS = ("panorama", "layout", "structure")
UP = 2


def complete_room(
    frame: Frame, levelling: Levelling, networks: Container[str], max_depth_m: float, seed: int
) -> CompletedRoom:
    """Complete one scan; one that shows nothing stays as it is.

    Args:
        frame: its pixels.
        levelling: its up direction is used.
        networks: which of `NETWORKS` are asked.
        max_depth_m: depth beyond this is not shown to them.
        seed: of the choice of points for the point networks.

    Raises:
        FewviewError: shipped weights are missing or damaged.
    """
    depth = np.where(frame.depth < max_depth_m, frame.depth, np.float32(0))
    up = levelling.level_R_scan[UP]
    ring = panorama.scan_ring(depth, frame.colour, frame.intrinsics, up)
    if not ring.depth.any():
        return CompletedRoom(ring)
    points = layout.scan_points(ring, np.random.default_rng(seed))
    return CompletedRoom(
        ring,
        panorama.complete_ring(ring) if "panorama" in networks else None,
        layout.complete_layout(ring, points) if "layout" in networks else None,
        structure.complete_planes(points) if "structure" in networks else None,
    )
