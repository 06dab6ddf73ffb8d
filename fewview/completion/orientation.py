"""Which way up the images are: quarter turns that bring all of them into a common orientation.

Learned keypoints do not survive in-plane rotation. Two cues tell the turns. Between images, mutual
nearest neighbours of descriptors are most at the right relative turn, even where views share
little: hundreds of them leave no doubt, ten prove nothing. Within an image, surface below the
camera looks up and what is further up is further away; an image says little by that, a folder of
images held alike a lot. Each cue is a conditional logit over the four turns, fitted by
scripts/fit_orientation.py.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.special import log_softmax

from fewview.completion.levelling import upright as upright_axis
from fewview.completion.local_geometry import DepthView, thin_surface
from fewview.completion.xfeat import describe
from fewview.types import Array, FloatArray, Frame, IntArray

SMALL_WIDTH = 320
KEYPOINTS = 400
MIN_COSINE = 0.82
COARSE_VOXEL_M = 0.12
MAX_DEPTH_M = 6.0
FACING_COS = 0.8
MATCHES_LOGIT = np.array([-1.83, 1.83])
"""Of log(1 + m) and sqrt(m) of the m matches of a pair at each relative turn."""
CUES_LOGIT = np.array([-5.98, 3.32, 8.01, -1.61, 1.34])
"""Of the `upright_cues` of an image at each turn."""
AS_TAKEN = 2.0
"""Prior log odds of an image being upright as it was taken, against each other turn."""
MIN_GAIN = 7.0
"""Log odds that each image turned against most others must bring, on average."""
MIN_COMMON_GAIN = 6.0
"""Log odds that turning all images alike must bring."""


@dataclass(frozen=True)
class Glance:
    """What is needed of one image.

    Attributes:
        descriptors: of the small image after 0, 1, 2 and 3 counter-clockwise quarter turns.
        upright: (4,) log probability, by the image alone, that it needs that many turns to stand
            upright.
    """

    descriptors: tuple[FloatArray, ...]
    upright: Array


def glance(frame: Frame) -> Glance:
    """Look at one image in all four turns."""
    scale = SMALL_WIDTH / max(frame.colour.shape[:2])
    small = cv2.resize(frame.colour, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    described = tuple(describe(small, turns, KEYPOINTS)[1] for turns in range(4))
    return Glance(described, log_softmax(upright_cues(frame) @ CUES_LOGIT))


def quarter_turns(glances: list[Glance]) -> IntArray:
    """Counter-clockwise quarter turns (n,) that bring n images upright.

    Images are left as they were taken unless turning them is clearly better.
    """
    count = len(glances)
    found = np.zeros((count, count, 4))
    for i, j in itertools.combinations(range(count), 2):
        found[i, j] = matches(glances[i].descriptors, glances[j].descriptors)
    return chosen_turns(match_votes(found), np.array([g.upright for g in glances]).reshape(-1, 4))


def chosen_turns(votes: FloatArray, upright: Array) -> IntArray:
    """(n,) turns: as taken, all alike, or some against most others, whichever is likeliest.

    Args:
        votes: (n, n, 4) `match_votes` of all pairs.
        upright: (n, 4) of `Glance`.
    """
    everyone = np.arange(len(upright))
    own = upright + AS_TAKEN * (np.arange(4) == 0)
    mixed = _synchronise(votes, own)
    common = [own[everyone, (mixed + t) % 4].sum() for t in range(4)]
    mixed = (mixed + int(np.argmax(common))) % 4
    alike = [np.full_like(mixed, t) for t in range(4)]

    def log_odds(turns: IntArray) -> float:
        against = len(turns) - np.bincount(turns).max()
        price = MIN_GAIN * against if against else MIN_COMMON_GAIN * turns.any()
        return _total(votes, upright, turns) - float(price)

    return max([*alike, mixed], key=log_odds)


def upright_cues(frame: Frame) -> Array:
    """(4, 5) what speaks for an image needing 0, 1, 2 or 3 turns: shares of its surface that look
    like floor and like ceiling, their square roots, and how depth grows upward."""
    surface = thin_surface(DepthView.of(frame, MAX_DEPTH_M), frame.colour, COARSE_VOXEL_M)
    right, down = _depth_slopes(frame.depth)
    cues = []
    for turns in range(4):
        up = upright_axis(turns)
        facing, height = surface.normals @ up, surface.points @ up
        count = max(len(height), 1)
        floor = ((facing > FACING_COS) & (height < 0)).sum() / count
        ceiling = ((facing < -FACING_COS) & (height > 0)).sum() / count
        slope = np.tanh(2.0 * (up[0] * right + up[1] * down))
        cues.append([floor, ceiling, np.sqrt(floor), np.sqrt(ceiling), slope])
    return np.array(cues)


def _depth_slopes(depth: FloatArray) -> tuple[float, float]:
    """How the logarithm of depth grows from the image's centre to its right edge and down."""
    height, width = depth.shape
    row, column = np.nonzero(depth > 0)
    if len(row) < 2:
        return 0.0, 0.0
    logarithm = np.log(depth[row, column].astype(np.float64))
    logarithm -= logarithm.mean()
    x, y = 2.0 * column / width - 1.0, 2.0 * row / height - 1.0
    return float((logarithm @ x) / (x @ x)), float((logarithm @ y) / (y @ y))


def match_votes(found: Array) -> FloatArray:
    """(n, n, 4) log probabilities that the second image is turned d times more than the first,
    weighed with how far the likeliest is from a guess: what hardly stands out is the same wrong
    hint in many pairs.

    Args:
        found: (n, n, 4) `matches` of images and later ones; the rest is not looked at.
    """
    votes = log_softmax(np.stack([np.log1p(found), np.sqrt(found)], -1) @ MATCHES_LOGIT, -1)
    votes *= (np.exp(votes.max(axis=-1, keepdims=True)) - 0.25) / 0.75
    forward = np.where(np.triu(np.ones(votes.shape[:2], dtype=bool), 1)[..., None], votes, 0.0)
    backward = forward.swapaxes(0, 1)[..., [0, 3, 2, 1]]
    return np.asarray(forward + backward, dtype=np.float32)


def matches(first: tuple[FloatArray, ...], second: tuple[FloatArray, ...]) -> Array:
    """(4,) mutual matches of two images if the second is turned d times more than the first."""
    return np.array([_mutual(first[0], second[d]) for d in range(4)])


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
