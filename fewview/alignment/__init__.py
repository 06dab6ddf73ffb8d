"""Completed rooms laid over each other from above: four yaws and every shift (Sec. 3.2, layout)."""

from fewview.alignment.align import (
    NEVER,
    Alignment,
    Embedded,
    RoomPoses,
    embed,
    planar_motion,
    pose_of,
    shipped_network,
)
from fewview.alignment.drawing import CHANNELS, Drawing, draw
from fewview.alignment.joint import joint_drawing
from fewview.alignment.network import AlignerNetwork, AlignerNetworkConfig

__all__ = [
    "CHANNELS",
    "NEVER",
    "AlignerNetwork",
    "AlignerNetworkConfig",
    "Alignment",
    "Drawing",
    "Embedded",
    "RoomPoses",
    "draw",
    "embed",
    "joint_drawing",
    "planar_motion",
    "pose_of",
    "shipped_network",
]
