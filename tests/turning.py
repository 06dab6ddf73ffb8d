"""Turning a scan's images by quarter turns, as if the camera had been rolled."""

from __future__ import annotations

import numpy as np

from fewview.types import Array, Frame


def turned_frame(frame: Frame, turns: int) -> tuple[Frame, Array]:
    """The frame a camera rolled by quarter turns would have taken, and turned_R_scan (3, 3)."""
    camera = frame.intrinsics
    turned_R_scan = np.eye(3)
    for _ in range(turns % 4):
        camera = camera.quarter_turned()
        turned_R_scan = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]) @ turned_R_scan
    return (
        Frame(
            np.ascontiguousarray(np.rot90(frame.colour, turns)),
            np.ascontiguousarray(np.rot90(frame.depth, turns)),
            camera,
        ),
        turned_R_scan,
    )
