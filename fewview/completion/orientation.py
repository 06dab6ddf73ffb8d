"""Which way up the images are: quarter turns that bring all of them into a common orientation.

Learned keypoints do not survive in-plane rotation. Two cues tell the turns. Between images, mutual
nearest neighbours of descriptors peak sharply at the right relative turn, even where views share
little. Within an image, more surface looks up from below the camera than down from above it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from fewview.completion.levelling import upright
from fewview.completion.local_geometry import DepthView, thin_surface
from fewview.completion.xfeat import describe
from fewview.types import Array, FloatArray, Frame, IntArray, Surface

SMALL_WIDTH = 320
KEYPOINTS = 400
MIN_COSINE = 0.82
COARSE_VOXEL_M = 0.12
MAX_DEPTH_M = 6.0
FACING_COS = 0.8
SIGNIFICANT = 3.0
MIN_GAIN = 10.0
FLOOR_WEIGHT = 20.0
UPRIGHT_PRIOR = 3.0


@dataclass(frozen=True)
class Glance:
    """What is needed of one image.

    Attributes:
        descriptors: of the small image after 0, 1, 2 and 3 counter-clockwise quarter turns.
        floor: (4,) share of the surface that looks like floor, less that which looks like
            ceiling, if the image needs that many turns to stand upright.
    """

    descriptors: tuple[FloatArray, ...]
    floor: Array


def glance(frame: Frame) -> Glance:
    """Look at one image in all four turns."""
    scale = SMALL_WIDTH / max(frame.colour.shape[:2])
    small = cv2.resize(frame.colour, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    described = tuple(describe(small, turns, KEYPOINTS)[1] for turns in range(4))
    surface = thin_surface(DepthView.of(frame, MAX_DEPTH_M), frame.colour, COARSE_VOXEL_M)
    return Glance(described, np.array([_floor_share(surface, turns) for turns in range(4)]))


def quarter_turns(glances: list[Glance]) -> IntArray:
    """Counter-clockwise quarter turns (n,) that bring n images upright.

    Images are left as they were taken unless turning them is clearly better.
    """
    votes = _relative_votes([g.descriptors for g in glances])
    own = FLOOR_WEIGHT * np.array([g.floor for g in glances])
    own[:, 0] += UPRIGHT_PRIOR
    turns = _synchronise(votes, own)
    totals = [own[np.arange(len(turns)), (turns + t) % 4].sum() for t in range(4)]
    turns = (turns + int(np.argmax(totals))) % 4
    as_taken = np.zeros_like(turns)
    gain = _total(votes, own, turns) - _total(votes, own, as_taken)
    return turns if gain > MIN_GAIN * np.count_nonzero(turns) else as_taken


def _floor_share(surface: Surface, turns: int) -> float:
    if len(surface.points) == 0:
        return 0.0
    up = upright(turns)
    facing, height = surface.normals @ up, surface.points @ up
    floor = (facing > FACING_COS) & (height < 0)
    ceiling = (facing < -FACING_COS) & (height > 0)
    return float(floor.mean() - ceiling.mean())


def _relative_votes(descriptors: list[tuple[FloatArray, ...]]) -> FloatArray:
    """(n, n, 4) votes for the second image being turned d times more than the first."""
    count = len(descriptors)
    votes = np.zeros((count, count, 4), dtype=np.float32)
    for i in range(count):
        for j in range(i + 1, count):
            found = np.array([_mutual(descriptors[i][0], descriptors[j][d]) for d in range(4)])
            votes[i, j] = _vote(found)
            votes[j, i] = votes[i, j][[0, 3, 2, 1]]
    return votes


def _vote(found: Array) -> Array:
    """Matches per turn, worth less when the best turn hardly stands out."""
    second, first = np.sort(found)[2:]
    significance = (first - second) / np.sqrt(first + second + 1.0)
    trust = min(1.0, (significance / SIGNIFICANT) ** 2)
    return np.asarray(trust * found**2 / (found.sum() + 10.0))


def _mutual(a: FloatArray, b: FloatArray) -> float:
    if len(a) == 0 or len(b) == 0:
        return 0.0
    cosine = a @ b.T
    best = cosine.argmax(axis=1)
    mutual = cosine.argmax(axis=0)[best] == np.arange(len(a))
    return float((mutual & (cosine.max(axis=1) > MIN_COSINE)).sum())


def _synchronise(votes: FloatArray, own: Array) -> IntArray:
    """Turns that maximise the summed votes of pairs and images: grow from the surest image, then
    improve one by one."""
    count = len(votes)
    turns = np.zeros(count, dtype=np.int64)
    ordered = np.sort(votes, axis=2)
    margin = ordered[..., 3] - ordered[..., 2]
    placed = np.zeros(count, dtype=bool)
    first = int(margin.sum(axis=1).argmax())
    placed[first] = True
    turns[first] = own[first].argmax()
    while not placed.all():
        outside = np.flatnonzero(~placed)
        score = np.stack([_score(votes, own, turns, placed, i) for i in outside.tolist()])
        top = np.sort(score, axis=1)
        pick = int((top[:, 3] - top[:, 2]).argmax())
        turns[outside[pick]] = score[pick].argmax()
        placed[outside[pick]] = True
    for _ in range(10):
        before = turns.copy()
        for i in range(count):
            turns[i] = _score(votes, own, turns, np.arange(count) != i, i).argmax()
        if (turns == before).all():
            break
    return turns


def _score(votes: FloatArray, own: Array, turns: IntArray, others: np.ndarray, i: int) -> Array:
    """(4,) votes of the other images and of image i itself for each of its turns."""
    who = np.flatnonzero(others)
    relative = (np.arange(4)[:, None] - turns[who][None]) % 4
    return np.asarray(votes[who[None], i, relative].sum(axis=1) + own[i])


def _total(votes: FloatArray, own: Array, turns: IntArray) -> float:
    """Votes of all pairs and images for a set of turns."""
    relative = (turns[None] - turns[:, None]) % 4
    pairs = np.take_along_axis(votes, relative[..., None], axis=2)[..., 0]
    return float(np.triu(pairs, 1).sum() + own[np.arange(len(turns)), turns].sum())
