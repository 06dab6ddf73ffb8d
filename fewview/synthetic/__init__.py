"""Procedural furnished rooms, rendered to RGB-D scans with ground truth."""

from fewview.synthetic.camera import ViewMode, kinect, sample_views
from fewview.synthetic.render import render
from fewview.synthetic.room import Room, make_room
from fewview.synthetic.scene import Split, SyntheticScene, generate, split_seed, write

__all__ = [
    "Room",
    "Split",
    "SyntheticScene",
    "ViewMode",
    "generate",
    "kinect",
    "make_room",
    "render",
    "sample_views",
    "split_seed",
    "write",
]
