"""Procedural furnished rooms, rendered to RGB-D scans with ground truth."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fewview.synthetic.camera import ViewMode, kinect, sample_views
    from fewview.synthetic.frames import render
    from fewview.synthetic.room import Room, make_room
    from fewview.synthetic.samples import RoomSample, room_sample
    from fewview.synthetic.scene import Split, SyntheticScene, generate, split_seed, write

_HOMES = {
    "Room": "room",
    "RoomSample": "samples",
    "Split": "scene",
    "SyntheticScene": "scene",
    "ViewMode": "camera",
    "generate": "scene",
    "kinect": "camera",
    "make_room": "room",
    "render": "frames",
    "room_sample": "samples",
    "sample_views": "camera",
    "split_seed": "scene",
    "write": "scene",
}
__all__ = [
    "Room",
    "RoomSample",
    "Split",
    "SyntheticScene",
    "ViewMode",
    "generate",
    "kinect",
    "make_room",
    "render",
    "room_sample",
    "sample_views",
    "split_seed",
    "write",
]


def __getattr__(name: str) -> Any:
    """Public names are imported when first used: samples need neither Open3D nor OpenCV."""
    if name not in _HOMES:
        raise AttributeError(f"module 'fewview.synthetic' has no attribute '{name}'")
    return getattr(importlib.import_module(f"fewview.synthetic.{_HOMES[name]}"), name)
