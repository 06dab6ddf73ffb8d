"""Which way up the images are: quarter turns that bring all of them into a common orientation.

Learned keypoints do not survive in-plane rotation. Mutual nearest neighbours of a small image's
descriptors peak sharply at the right relative quarter turn, even between views that share little;
the relative turns of all pairs are then synchronised.
"""

from __future__ import annotations

import cv2
import numpy as np

from fewview.completion.xfeat import describe
from fewview.types import FloatArray, Frame, IntArray

SMALL_WIDTH = 320
KEYPOINTS = 400
MIN_COSINE = 0.82


def turned_descriptors(frame: Frame) -> tuple[FloatArray, ...]:
    """Descriptors of the small image after 0, 1, 2 and 3 counter-clockwise quarter turns."""
    scale = SMALL_WIDTH / max(frame.colour.shape[:2])
    small = cv2.resize(frame.colour, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return tuple(describe(small, turns, KEYPOINTS)[1] for turns in range(4))


def quarter_turns(descriptors: list[tuple[FloatArray, ...]]) -> IntArray:
    """Counter-clockwise quarter turns (n,) that bring n images into a common orientation.

    The orientation that most images already have is taken as upright.
    """
    votes = _relative_votes(descriptors)
    turns = _synchronise(votes)
    upright = int(np.bincount(turns, minlength=4).argmax())
    return (turns - upright) % 4


def _relative_votes(descriptors: list[tuple[FloatArray, ...]]) -> FloatArray:
    """(n, n, 4) share of mutual matches when the second image is turned d times more."""
    count = len(descriptors)
    votes = np.zeros((count, count, 4), dtype=np.float32)
    for i in range(count):
        for j in range(i + 1, count):
            found = np.array([_mutual(descriptors[i][0], descriptors[j][d]) for d in range(4)])
            votes[i, j] = found**2 / (found.sum() + 10.0)
            votes[j, i] = votes[i, j][[0, 3, 2, 1]]
    return votes


def _mutual(a: FloatArray, b: FloatArray) -> float:
    if len(a) == 0 or len(b) == 0:
        return 0.0
    cosine = a @ b.T
    best = cosine.argmax(axis=1)
    mutual = cosine.argmax(axis=0)[best] == np.arange(len(a))
    return float((mutual & (cosine.max(axis=1) > MIN_COSINE)).sum())


def _synchronise(votes: FloatArray) -> IntArray:
    """Turns that maximise the summed votes: grow from the surest image, then improve one by one."""
    count = len(votes)
    turns = np.zeros(count, dtype=np.int64)
    ordered = np.sort(votes, axis=2)
    margin = ordered[..., 3] - ordered[..., 2]
    placed = np.zeros(count, dtype=bool)
    placed[int(margin.sum(axis=1).argmax())] = True
    while not placed.all():
        outside = np.flatnonzero(~placed)
        score = np.stack([_score(votes, turns, placed, i) for i in outside.tolist()])
        top = np.sort(score, axis=1)
        pick = int((top[:, 3] - top[:, 2]).argmax())
        turns[outside[pick]] = score[pick].argmax()
        placed[outside[pick]] = True
    for _ in range(10):
        before = turns.copy()
        for i in range(count):
            turns[i] = _score(votes, turns, np.arange(count) != i, i).argmax()
        if (turns == before).all():
            break
    return turns


def _score(votes: FloatArray, turns: IntArray, others: np.ndarray, i: int) -> FloatArray:
    """(4,) summed votes of the other images for each turn of image i."""
    who = np.flatnonzero(others)
    relative = (np.arange(4)[:, None] - turns[who][None]) % 4
    return np.asarray(votes[who[None], i, relative].sum(axis=1))
