"""Procedural furnished rooms, rendered to RGB-D scans with ground truth."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fewview.synthetic.camera import ViewMode, kinect, sample_views
    from fewview.synthetic.frames import render
    from fewview.synthetic.library import Library, read_library
    from fewview.synthetic.room import Room, make_room
    from fewview.synthetic.samples import RoomSample, room_sample
    from fewview.synthetic.scene import SyntheticScene, generate, write
    from fewview.synthetic.splits import Split, split_of, split_seed

_HOMES = {
    "Library": "library",
    "Room": "room",
    "RoomSample": "samples",
    "Split": "splits",
    "SyntheticScene": "scene",
    "ViewMode": "camera",
    "generate": "scene",
    "kinect": "camera",
    "make_room": "room",
    "read_library": "library",
    "render": "frames",
    "room_sample": "samples",
    "sample_views": "camera",
    "split_of": "splits",
    "split_seed": "splits",
    "write": "scene",
}
__all__ = [
    "Library",
    "Room",
    "RoomSample",
    "Split",
    "SyntheticScene",
    "ViewMode",
    "generate",
    "kinect",
    "make_room",
    "read_library",
    "render",
    "room_sample",
    "sample_views",
    "split_of",
    "split_seed",
    "write",
]


def __getattr__(name: str) -> Any:
    """Public names are imported when first used: samples need neither Open3D nor OpenCV."""
    if name not in _HOMES:
        raise AttributeError(f"module 'fewview.synthetic' has no attribute '{name}'")
    return getattr(importlib.import_module(f"fewview.synthetic.{_HOMES[name]}"), name)
