"""The completed layout of one scan."""

from __future__ import annotations

from collections.abc import Sequence
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
    wall_T_level = se3.pose(scan.wall_R_level.astype(np.float64), np.zeros(3))
    (layout,) = completed_layouts(network, batch, [wall_T_level @ ring.level_T_scan])
    return layout


def completed_layouts(
    network: LayoutNetwork, batch: PointBatch, level_T_scan: Sequence[Array]
) -> list[CompletedLayout]:
    """The layouts of several scans' points, each in a grid frame (4, 4)."""
    with torch.inference_mode():
        output = network(batch)
        probabilities = network.probabilities(output.logits)
        classes = network.classes(output.logits)
        confidence = probabilities.gather(1, classes[:, None])[:, 0]
        columns = {
            "probabilities": probabilities,
            "classes": classes.to(torch.uint8),
            "descriptors": output.descriptors.permute(0, 2, 3, 1),
            "confidence": confidence,
            "observed": observed_cells(output),
        }
    arrays = {name: column.cpu().numpy() for name, column in columns.items()}
    floors = output.floor.cpu().numpy()
    return [
        CompletedLayout(
            level_T_scan=frame,
            floor=_plane(floors[i]),
            **{name: array[i] for name, array in arrays.items()},
        )
        for i, frame in enumerate(level_T_scan)
    ]


def _plane(floor: FloatArray) -> Array:
    """(4,) upward unit normal and offset of the network's floor (3,) z = h + a x + b y."""
    h, a, b = floor.astype(np.float64)
    plane = np.array([-a, -b, 1.0, h])
    return np.asarray(plane / np.linalg.norm(plane[:3]))
