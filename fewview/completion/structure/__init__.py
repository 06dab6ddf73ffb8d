"""The third representation of Sec. 3.2: the planes of a scan's room, seen or not."""

from fewview.completion.structure.complete import (
    complete_planes,
    shipped_network,
)
from fewview.completion.structure.network import StructureNetwork, StructureNetworkConfig

__all__ = [
    "StructureNetwork",
    "StructureNetworkConfig",
    "complete_planes",
    "shipped_network",
]
