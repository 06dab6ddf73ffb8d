"""Completed rooms laid over each other from above: four yaws and every shift (Sec. 3.2, layout)."""

from fewview.alignment.align import (
    Alignment,
    Embedded,
    RoomPoses,
    embed,
    planar_motion,
    pose_of,
    shipped_network,
)
from fewview.alignment.drawing import CHANNELS, Drawing, draw
from fewview.alignment.network import AlignerNetwork, AlignerNetworkConfig

__all__ = [
    "CHANNELS",
    "AlignerNetwork",
    "AlignerNetworkConfig",
    "Alignment",
    "Drawing",
    "Embedded",
    "RoomPoses",
    "draw",
    "embed",
    "planar_motion",
    "pose_of",
    "shipped_network",
]
