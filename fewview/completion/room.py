"""The room around one scan in whichever of the three representations are asked for (Sec. 3.2)."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import replace
from typing import TypeVar

import numpy as np

from fewview.completion import layout, panorama, structure
from fewview.types import (
    CompletedLayout,
    CompletedPanorama,
    CompletedPlanes,
    CompletedRoom,
    Frame,
    Levelling,
)

NETWORKS = ("panorama", "layout", "structure")
UP = 2
Part = TypeVar("Part", CompletedPanorama, CompletedLayout, CompletedPlanes)


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


def without_descriptors(room: CompletedRoom) -> CompletedRoom:
    """A room whose features were taken: its dense descriptors, half of its size, serve no other
    end."""
    return replace(
        room,
        panorama=room.panorama and _without_descriptors(room.panorama),
        layout=room.layout and _without_descriptors(room.layout),
        planes=room.planes and _without_descriptors(room.planes),
    )


def _without_descriptors(part: Part) -> Part:
    return replace(part, descriptors=np.zeros((*part.descriptors.shape[:-1], 0), np.float32))
