"""Completed rooms as pictures, with the truth below where it is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmark.completion_networks import Networks
from benchmark.completion_scores import seen_cells
from benchmark.completion_views import View
from benchmark.page import GAP_PX, captioned, framed
from benchmark.rendering import Picture
from fewview.completion.layout.grid import CLASSES as GROUND_CLASSES
from fewview.completion.layout.points import ScanPoints
from fewview.completion.panorama.network import CLASSES
from fewview.recording.room_pictures import layout_picture, panorama_picture
from fewview.types import CompletedLayout, CompletedPanorama, RingScan

PHOTOGRAPH_PX = 360
FRAME_COLOUR = (90, 90, 90)


@dataclass(frozen=True)
class Subject:
    """A scan to be drawn.

    Attributes:
        name: for captions and files.
        photograph: (H, W, 3) its colour image, where it has one.
        ring, points: what the networks are given of it.
        view: with the truth, where that is known.
    """

    name: str
    photograph: Picture | None
    ring: RingScan
    points: ScanPoints
    view: View | None


def drawn(subject: Subject, networks: Networks) -> Picture:
    """The scan's completed 360-image beside its colour image and layout, and the truth below."""
    room = networks.complete(subject.ring, subject.points)
    photograph = subject.photograph
    left = [] if photograph is None else [framed(photograph, PHOTOGRAPH_PX, FRAME_COLOUR)]
    left += [] if room.layout is None else [layout_picture(room.layout)]
    right = [] if room.panorama is None else [panorama_picture(room.ring, room.panorama)]
    rows = [captioned(_row(left, right), f"{subject.name}: as seen and as completed")]
    if subject.view is not None:
        true = [layout_picture(_true_layout(subject.view))]
        ring = [panorama_picture(subject.ring, _true_panorama(subject.view))]
        rows.append(captioned(_row(true, ring), f"{subject.name}: as seen and as it is"))
    return _stacked(rows)


def _true_panorama(view: View) -> CompletedPanorama:
    truth = view.truth
    return CompletedPanorama(
        truth.depth,
        truth.normals,
        np.eye(len(CLASSES), dtype=np.float32)[truth.semantics],
        np.zeros((*truth.depth.shape, 1), np.float32),
        (truth.depth > 0).astype(np.float32),
        view.ring.depth > 0,
        view.ring.level_T_scan,
    )


def _true_layout(view: View) -> CompletedLayout:
    truth = view.truth
    classes = np.eye(len(GROUND_CLASSES), dtype=np.float32)[truth.ground]
    return CompletedLayout(
        truth.grid_T_world @ np.linalg.inv(view.level_T_world) @ view.ring.level_T_scan,
        classes.transpose(2, 0, 1),
        truth.ground,
        np.zeros((*truth.ground.shape, 1), np.float32),
        truth.ground_known.astype(np.float32),
        seen_cells(view),
        np.array([0.0, 0.0, 1.0, truth.floor_z]),
    )


def _row(left: Sequence[Picture], right: Sequence[Picture]) -> Picture:
    parts = [_stacked(column) for column in (left, right) if column]
    height = max(len(part) for part in parts)
    padded = [_padded(part, height - len(part), GAP_PX) for part in parts]
    return np.concatenate(padded, axis=1)


def _stacked(pictures: Sequence[Picture]) -> Picture:
    width = max(p.shape[1] for p in pictures)
    return np.concatenate([_padded(p, GAP_PX, width - p.shape[1]) for p in pictures])


def _padded(picture: Picture, below: int, right: int) -> Picture:
    return np.pad(picture, ((0, below), (0, right), (0, 0)), constant_values=255)
