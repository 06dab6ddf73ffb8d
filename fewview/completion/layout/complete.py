"""The completed layout of one scan."""

from __future__ import annotations

from functools import cache

import numpy as np
import torch

from fewview import weights
from fewview.completion.layout.network import LayoutNetwork, LayoutNetworkConfig, LayoutOutput
from fewview.completion.layout.pointnet import PointBatch
from fewview.completion.layout.points import ScanPoints
from fewview.geometry import se3
from fewview.types import Array, CompletedLayout, FloatArray, RingScan

NAME = "layout"


def observed_cells(output: LayoutOutput) -> torch.Tensor:
    """(B, CELLS, CELLS) bool: cells with a point or that the camera looked through."""
    return output.occupied | (output.free.amax(dim=1) > 0)


@cache
def shipped_network() -> LayoutNetwork:
    """The network with the weights that come with the package.

    Raises:
        FewviewError: they are missing or damaged.
    """
    return weights.shipped(NAME, lambda size: LayoutNetwork(LayoutNetworkConfig(**size)))


def complete_layout(
    ring: RingScan, scan: ScanPoints, network: LayoutNetwork | None = None
) -> CompletedLayout:
    """Predict the room around a scan from above.

    Args:
        ring: the scan on the ring; scan: points drawn from it.
        network: the shipped one when not given.

    Raises:
        FewviewError: the shipped weights are missing or damaged.
    """
    network = shipped_network() if network is None else network
    device = network.class_weights.device
    batch = PointBatch(*(t.to(device) for t in PointBatch.of([scan])))
    with torch.inference_mode():
        output = network(batch)
        probabilities = network.probabilities(output.logits)[0]
        observed = observed_cells(output)[0]
    wall_T_level = se3.pose(scan.wall_R_level.astype(np.float64), np.zeros(3))
    return CompletedLayout(
        wall_T_level @ ring.level_T_scan,
        probabilities.cpu().numpy(),
        output.descriptors[0].permute(1, 2, 0).cpu().numpy(),
        probabilities.amax(dim=0).cpu().numpy(),
        observed.cpu().numpy(),
        floor_plane(output.floor[0].cpu().numpy()),
    )


def floor_plane(floor: FloatArray) -> Array:
    """(4,) upward unit normal and offset of the network's floor (3,) z = h + a x + b y."""
    h, a, b = floor.astype(np.float64)
    plane = np.array([-a, -b, 1.0, h])
    return np.asarray(plane / np.linalg.norm(plane[:3]))
