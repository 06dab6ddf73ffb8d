"""Training rooms as the verifier sees them: every view completed and drawn from above."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from fewview import weights
from fewview.alignment import Drawing, draw
from fewview.completion.layout.complete import NAME, floor_plane, observed_cells
from fewview.completion.layout.network import LayoutNetwork, LayoutNetworkConfig
from fewview.completion.layout.points import POINTS
from fewview.completion.panorama.ring import ring_points
from fewview.geometry import se3
from fewview.training.point_batches import room_points
from fewview.types import Array, CompletedLayout, RingScan

if TYPE_CHECKING:
    from fewview.synthetic.samples import RoomSample

VOXEL_M = 0.2
APART = 0.1


@dataclass(frozen=True)
class DrawnRooms:
    """The views of some rooms one after the other, B in all.

    Attributes:
        drawings: B of them; their ``level_T_scan`` begins at the view's level frame.
        level_T_world: (B, 4, 4).
        seen: voxels of the world that each view measured.
    """

    drawings: list[Drawing]
    level_T_world: Array
    seen: list[frozenset[int]]

    def shared(self, a: int, b: int) -> float:
        """Share 0..1 of the smaller view's voxels that the other measured too."""
        smaller = max(1, min(len(self.seen[a]), len(self.seen[b])))
        return len(self.seen[a] & self.seen[b]) / smaller

    def apart(self, a: int, b: int) -> bool:
        """Whether they share less than a tenth of their surface."""
        return self.shared(a, b) < APART

    def target_T_source(self, a: int, b: int) -> Array:
        """(4, 4) from the level frame of view ``a`` to that of view ``b``."""
        return np.asarray(self.level_T_world[b] @ se3.inverse(self.level_T_world[a]))


def drawn_rooms(
    rooms: Sequence[RoomSample], weights_folder: str, tilt_deg: float, rng: np.random.Generator
) -> DrawnRooms:
    """Complete and draw every view.

    Args:
        rooms: where the views are.
        weights_folder: of the layout network, empty for the shipped ones.
        tilt_deg: standard deviation of the error of the level frame about each horizontal axis.
        rng: chooses points and tilts.

    Raises:
        FewviewError: the weights are missing or damaged.
    """
    scans = room_points(rooms, POINTS, tilt_deg, rng)
    network = _layout_network(weights_folder)
    with torch.inference_mode():
        output = network(scans.batch)
        chance = network.probabilities(output.logits).numpy()
        observed = observed_cells(output).numpy()
    frames = se3.pose(scans.tilts @ scans.turns, np.zeros((len(scans.turns), 3)))
    level_T_world = np.concatenate([room.level_T_world for room in rooms])
    drawings, seen = [], []
    colours, depths = (
        np.concatenate([getattr(r, n) for r in rooms]) for n in ("colour", "measured")
    )
    for i, (colour, depth) in enumerate(zip(colours, depths, strict=True)):
        ring = RingScan(colour, depth, np.eye(4))
        layout = CompletedLayout(
            level_T_scan=frames[i],
            probabilities=chance[i],
            descriptors=np.zeros((0, 0, 0), np.float32),
            confidence=chance[i].max(axis=0),
            observed=observed[i],
            floor=floor_plane(output.floor[i].numpy()),
        )
        drawings.append(draw(ring, layout))
        points = ring_points(depth)[depth > 0].astype(np.float64)
        seen.append(_voxels(se3.transform(se3.inverse(level_T_world[i]), points)))
    return DrawnRooms(drawings, level_T_world, seen)


@cache
def _layout_network(folder: str) -> LayoutNetwork:
    return weights.shipped(
        NAME,
        lambda size: LayoutNetwork(LayoutNetworkConfig(**size)),
        Path(folder) if folder else weights.FOLDER,
    )


def _voxels(points: Array) -> frozenset[int]:
    """The cells of a grid in the world that hold points (n, 3)."""
    index = np.floor(points / VOXEL_M).astype(np.int64) + 512
    return frozenset((index @ [1 << 20, 1 << 10, 1]).tolist())
