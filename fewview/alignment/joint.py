"""Scans that stand together drawn as one: what is placed already, on the grid of one of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from fewview.alignment.align import planar_motion
from fewview.alignment.drawing import (
    LEVEL_COLOURS,
    OBSERVED,
    PREDICTED,
    SHOWN,
    UPRIGHT_COLOURS,
    Drawing,
)
from fewview.completion.layout.grid import CELLS, cell_centres, cells_of
from fewview.types import Array, BoolArray, FloatArray


def joint_drawing(target: Drawing, others: Sequence[Drawing], target_T_other: Array) -> Drawing:
    """The room that several scans show between them.

    What any of them saw is shown; where at least one of them observed a cell, its prediction is
    that of the observers, elsewhere the mean of all that reach so far.

    Args:
        target: its grid is drawn on.
        others: n more scans.
        target_T_other: (n, 4, 4).
    """
    poses = zip(others, target_T_other, strict=True)
    moved = [_moved(other, target, pose) for other, pose in poses]
    everywhere = np.ones((CELLS, CELLS), dtype=bool)
    views, inside = zip((target.channels, everywhere), *moved, strict=True)
    channels, reach = np.stack(views), np.stack(inside)
    observed = channels[:, OBSERVED] > 0
    sayers = np.where(observed.any(axis=0), observed, reach)
    joint = np.empty_like(target.channels)
    joint[PREDICTED] = _mean(channels[:, PREDICTED], sayers)
    joint[OBSERVED] = observed.any(axis=0)
    joint[SHOWN] = channels[:, SHOWN].max(axis=0)
    for colours in (UPRIGHT_COLOURS, LEVEL_COLOURS):
        coloured = np.asarray(channels[:, colours].any(axis=1))
        joint[colours] = _mean(channels[:, colours], coloured)
    return Drawing(joint, target.level_T_scan, target.floor_z)


def _moved(other: Drawing, target: Drawing, target_T_other: Array) -> tuple[FloatArray, BoolArray]:
    """Channels of a drawing on the target's grid, and the cells that it reaches."""
    yaw, *shift = planar_motion(other, target, target_T_other[None])[0]
    cosine, sine = np.cos(yaw), np.sin(yaw)
    target_R_other = np.array([[cosine, -sine], [sine, cosine]])
    places = (cell_centres() - shift) @ target_R_other
    cells, inside = (t.numpy() for t in cells_of(torch.from_numpy(places.astype(np.float32))))
    found = other.channels.reshape(len(other.channels), -1)[:, cells.reshape(CELLS, CELLS)]
    reach = inside.reshape(CELLS, CELLS)
    return found * reach, reach


def _mean(values: FloatArray, where: BoolArray) -> FloatArray:
    """Mean over the first axis of (n, c, G, G) where (n, G, G) holds; 0 where it never does."""
    weight = where[:, None].astype(np.float32)
    return np.asarray((values * weight).sum(axis=0) / np.maximum(weight.sum(axis=0), 1.0))
