"""Views of generated validation rooms, and guests that stand nowhere among them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from fewview import synthetic
from fewview.errors import FewviewError
from fewview.types import Array, Frame

Views = tuple[list[Frame], Array]
"""n frames and their (n, 4, 4) poses."""


def views(index: int, count: int, mode: str = "random") -> Views:
    """What cameras see in a room of the validation split."""
    scene = synthetic.generate(synthetic.split_seed("validation", index), count, index, mode)
    return list(scene.frames), np.stack([scene.poses[name] for name in scene.names])


def strangers(rooms: Iterable[int], count: int) -> Views:
    """Views of the first of other rooms that has a place for them."""
    for index in rooms:
        with suppress(FewviewError):
            return views(index, count)
    raise FewviewError("no room has a place for strangers; name more of them")


def twins(frames: Sequence[Frame], poses: Array) -> Views:
    """What the same cameras see in the mirror image of the room."""
    flip = np.diag([-1.0, 1.0, 1.0, 1.0])
    flipped = []
    for frame in frames:
        camera = frame.intrinsics
        turned = replace(camera, cx=camera.width - 1 - camera.cx)
        colour, depth = frame.colour[:, ::-1].copy(), frame.depth[:, ::-1].copy()
        flipped.append(replace(frame, colour=colour, depth=depth, intrinsics=turned))
    return flipped, flip @ poses @ flip
