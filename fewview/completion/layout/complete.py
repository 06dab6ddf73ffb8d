"""The completed layout of one scan."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch

from fewview import weights
from fewview.completion.layout.grid import cell_centres
from fewview.completion.layout.network import LayoutNetwork, LayoutNetworkConfig, LayoutOutput
from fewview.completion.layout.pointnet import PointBatch
from fewview.completion.layout.points import ScanPoints
from fewview.types import Array, BoolArray, FloatArray

NAME = "layout"


@dataclass(frozen=True)
class LayoutCompletion:
    """A room from above on a grid along its walls; see `grid` for rows and columns.

    Attributes:
        places: (CELLS, CELLS, 2) x, y of the cells' centres in the ring's level frame, metres.
        probabilities: (5, CELLS, CELLS) of the classes in `grid.CLASSES`.
        descriptors: (CELLS, CELLS, 32) unit length.
        confidence: (CELLS, CELLS) probability that the most probable class is right.
        observed: (CELLS, CELLS) bool, cells with a point or that the camera looked through.
        floor: (4,) normal n (upwards) and offset d of the floor n . x = d, same frame.
    """

    places: FloatArray
    probabilities: FloatArray
    descriptors: FloatArray
    confidence: FloatArray
    observed: BoolArray
    floor: Array


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


def complete_layout(scan: ScanPoints, network: LayoutNetwork | None = None) -> LayoutCompletion:
    """Predict the room around a scan from above.

    Args:
        scan: its points.
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
    wall_R_level = scan.wall_R_level
    return LayoutCompletion(
        cell_centres() @ wall_R_level[:2, :2],
        probabilities.cpu().numpy(),
        output.descriptors[0].permute(1, 2, 0).cpu().numpy(),
        probabilities.amax(dim=0).cpu().numpy(),
        observed.cpu().numpy(),
        _floor_plane(output.floor[0].cpu().numpy(), wall_R_level),
    )


def _floor_plane(floor: FloatArray, wall_R_level: FloatArray) -> Array:
    h, a, b = floor.astype(np.float64)
    normal = np.array([-a, -b, 1.0])
    return np.asarray(np.append(normal @ wall_R_level, h) / np.linalg.norm(normal))
