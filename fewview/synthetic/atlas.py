"""All textures of a room in one image, with coarser copies of each against aliasing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np

from fewview.synthetic.textures import Image, Texture
from fewview.types import FloatArray, IntArray

_WIDTH = 4096
_LEVELS = 4
_MOTTLE = np.random.default_rng(0).normal(1.0, 0.08, (61, 61)).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Atlas:
    """A mip-mapped texture atlas.

    Attributes:
        image: (H, W, 3) uint8 that holds every level of every texture.
        origin: (textures, levels, 2) float32 x, y of their first pixels.
        size: (textures, levels, 2) float32 width, height.
        full: (textures, 2) float32 width, height of the textures at full detail.
        coarser: how many of these pixels one of the finest level covers.
    """

    image: Image
    origin: FloatArray
    size: FloatArray
    full: FloatArray
    coarser: float

    def lookup(self, texture: IntArray, uv: FloatArray, footprint: FloatArray) -> Image:
        """Colours (n, 3) uint8, bilinear in the level that suits each sample.

        Args:
            texture: (n,) which texture.
            uv: (n, 2) pixels at full detail; beyond its edges the texture is mirrored.
            footprint: (n,) pixels at full detail that a sample covers.
        """
        fineness = np.log2(np.maximum(footprint / np.float32(self.coarser), 1.0)) + 0.5
        level = np.clip(fineness, 0, self.size.shape[1] - 1).astype(np.int64)
        full, size = self.full[texture], self.size[texture, level]
        folded = full - np.abs(np.mod(uv + np.float32(0.5), 2 * full) - full)
        inside = np.clip(folded * (size / full) - np.float32(0.5), 0, size - 1)
        where = np.asarray(self.origin[texture, level] + inside, np.float32)
        return _sample(self.image, where)


@dataclass(frozen=True, eq=False)
class Tones:
    """Mottled mean colours, where there is no OpenCV to paint textures with.

    Attributes:
        tones: (textures, 3) float32.
    """

    tones: FloatArray

    def lookup(self, texture: IntArray, uv: FloatArray, footprint: FloatArray) -> Image:
        """Colours (n, 3) uint8 of pixels uv (n, 2) at full detail, mottled by position."""
        cell = np.floor(uv / 16.0).astype(np.int64) + 7 * texture[:, None]
        gain = _MOTTLE[cell[:, 0] % len(_MOTTLE), cell[:, 1] % len(_MOTTLE)]
        return np.asarray(np.clip(self.tones[texture] * gain[:, None], 0, 255), np.uint8)


def small(textures: Sequence[Texture], coarser: float) -> Atlas | Tones:
    """The textures for small images."""
    if find_spec("cv2") is None:
        return Tones(np.array([t.tone for t in textures], np.float32))
    return pack(textures, coarser)


def _sample(image: Image, where: FloatArray) -> Image:
    import cv2

    rows = -(-len(where) // 1024)
    grid = np.zeros((rows * 1024, 2), np.float32)
    grid[: len(where)] = where
    out = cv2.remap(image, grid.reshape(rows, 1024, 2), None, cv2.INTER_LINEAR)
    return np.asarray(out.reshape(-1, 3)[: len(where)])


def pack(textures: Sequence[Texture], coarser: float = 1.0) -> Atlas:
    """Paint ``textures`` and lay all their levels out on shelves, tallest first."""
    pieces = [level for t in textures for level in _levels(t.image(coarser))]
    origin = np.zeros((len(pieces), 2), np.int64)
    wide = max(_WIDTH if coarser == 1.0 else 1024, max(p.shape[1] for p in pieces))
    x = y = shelf = 0
    for number in sorted(range(len(pieces)), key=lambda i: -pieces[i].shape[0]):
        height, width = pieces[number].shape[:2]
        if x + width > wide:
            x, y, shelf = 0, y + shelf, 0
        origin[number] = x, y
        x, shelf = x + width, max(shelf, height)
    image = np.zeros((y + shelf, wide, 3), np.uint8)
    for piece, (left, top) in zip(pieces, origin.tolist(), strict=True):
        image[top : top + piece.shape[0], left : left + piece.shape[1]] = piece
    size = np.array([p.shape[1::-1] for p in pieces], np.float32)
    layout = (len(textures), _LEVELS, 2)
    return Atlas(
        image=image,
        origin=origin.reshape(layout).astype(np.float32),
        size=size.reshape(layout),
        full=np.array([t.size for t in textures], np.float32),
        coarser=coarser,
    )


def _levels(image: Image) -> list[Image]:
    import cv2

    out = [image]
    for _ in range(_LEVELS - 1):
        height, width = (max(1, n // 2) for n in out[-1].shape[:2])
        half = cv2.resize(out[-1], (width, height), interpolation=cv2.INTER_AREA)
        out.append(np.asarray(half, np.uint8))
    return out
