"""Views of validation rooms and folders, and guests that stand nowhere among them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from benchmark.ambiguity import look_alike
from benchmark.corridors import Likeness
from fewview import scans as readers
from fewview import synthetic
from fewview.errors import FewviewError
from fewview.types import Array, FloatArray, Frame

MOST_WARPED, WARPED_AT_M = 0.04, 3.0
"""Standard deviation of the relative error of depth that a room's sensor has at most, and at which
depth: measured surfaces of Kinects and Xtions are bent by centimetres, generated ones are not."""

WARPED = "-warped"
"""Ends the name of a scene that is seen through a sensor whose calibration is off."""

FIRST_CORRIDOR = 200
"""Seed of the first corridor that is fitted to; those before it are for tests."""
EACH, MIDDLE = 3, 2
"""Views of either half of a corridor, and of its middle in every second one."""

MOST_FRAMES = 24
"""Of a folder, spread evenly over it."""

Views = tuple[list[Frame], Array]
"""n frames and their (n, 4, 4) poses."""


def views(index: int, count: int, mode: str = "random", warped: bool = False) -> Views:
    """What cameras see in a room of the validation split, through the sensor of the generator, or
    through one whose calibration is off."""
    scene = synthetic.generate(synthetic.split_seed("validation", index), count, index, mode)
    frames, poses = list(scene.frames), np.stack([scene.poses[name] for name in scene.names])
    return _through(index, frames, warped), poses


def corridor_views(index: int, warped: bool = False) -> Views:
    """What cameras see in a corridor whose second half is the mirror image of the first."""
    seed, middle = FIRST_CORRIDOR + index, MIDDLE * (index % 2)
    seen = look_alike(Likeness.MIRRORED, EACH, middle, seed)
    return _through(index, [scan.load() for scan in seen.scans.scans], warped), seen.truth


def folder_views(path: Path) -> Views:
    """Scans with ground truth, at most `MOST_FRAMES` of them."""
    found, truth = readers.load(path).scans, readers.truth(path)
    known = [scan for scan in found if scan.name in truth]
    chosen = np.linspace(0, len(known) - 1, min(MOST_FRAMES, len(known))).astype(int)
    frames = [known[i].load() for i in chosen]
    return frames, np.stack([truth[known[i].name] for i in chosen])


def _through(index: int, frames: list[Frame], warped: bool) -> list[Frame]:
    """Frames as the sensor of a scene gives them."""
    if not warped:
        return frames
    rng = np.random.default_rng(index)
    coarse = rng.uniform(0.0, MOST_WARPED) * rng.standard_normal((4, 5))
    return [replace(frame, depth=_warped(frame.depth, coarse)) for frame in frames]


def _warped(depth: FloatArray, coarse: Array) -> FloatArray:
    """(h, w) depths as measured by a sensor whose calibration is off, by a (4, 5) share of the
    depth from one part of the image to another; more the further away."""
    height, width = depth.shape
    share = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.asarray(depth * (1.0 + share * depth / WARPED_AT_M), dtype=np.float32)


def strangers(rooms: Iterable[int], count: int, warped: bool = False) -> Views:
    """Views of the first of other rooms that has a place for them."""
    for index in rooms:
        with suppress(FewviewError):
            return views(index, count, warped=warped)
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
