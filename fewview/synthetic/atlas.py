"""All textures of a room in one image, with coarser copies of each against aliasing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from fewview.synthetic.textures import Image, Texture
from fewview.types import FloatArray, IntArray

_WIDTH = 4096
_LEVELS = 4


@dataclass(frozen=True, eq=False)
class Atlas:
    """A mip-mapped texture atlas.

    Attributes:
        image: (H, W, 3) uint8 that holds every level of every texture.
        origin: (textures, levels, 2) float32 x, y of their first pixels.
        size: (textures, levels, 2) float32 width, height.
    """

    image: Image
    origin: FloatArray
    size: FloatArray

    def lookup(self, texture: IntArray, uv: FloatArray, footprint: FloatArray) -> Image:
        """Colours (n, 3) uint8, bilinear in the level that suits each sample.

        Args:
            texture: (n,) which texture.
            uv: (n, 2) pixels of its finest level; beyond its edges the texture is mirrored.
            footprint: (n,) pixels of the finest level that a sample covers.
        """
        level = np.clip(np.log2(np.maximum(footprint, 1.0)) + 0.5, 0, _LEVELS - 1).astype(np.int64)
        full, size = self.size[texture, 0], self.size[texture, level]
        folded = full - np.abs(np.mod(uv + 0.5, 2 * full) - full)
        inside = np.clip(folded * (size / full) - 0.5, 0, size - 1)
        where = np.asarray(self.origin[texture, level] + inside, np.float32)
        return _sample(self.image, where)


def _sample(image: Image, where: FloatArray) -> Image:
    rows = -(-len(where) // 1024)
    grid = np.zeros((rows * 1024, 2), np.float32)
    grid[: len(where)] = where
    out = cv2.remap(image, grid.reshape(rows, 1024, 2), None, cv2.INTER_LINEAR)
    return np.asarray(out.reshape(-1, 3)[: len(where)])


def pack(textures: Sequence[Texture]) -> Atlas:
    """Lay all levels of ``textures`` out on shelves, tallest first."""
    pieces = [level for t in textures for level in _levels(t.image)]
    origin = np.zeros((len(pieces), 2), np.int64)
    x = y = shelf = 0
    for number in sorted(range(len(pieces)), key=lambda i: -pieces[i].shape[0]):
        height, width = pieces[number].shape[:2]
        if x + width > _WIDTH:
            x, y, shelf = 0, y + shelf, 0
        origin[number] = x, y
        x, shelf = x + width, max(shelf, height)
    image = np.zeros((y + shelf, _WIDTH, 3), np.uint8)
    for piece, (left, top) in zip(pieces, origin, strict=True):
        image[top : top + piece.shape[0], left : left + piece.shape[1]] = piece
    size = np.array([p.shape[1::-1] for p in pieces])
    layout = (len(textures), _LEVELS, 2)
    return Atlas(
        image, origin.reshape(layout).astype(np.float32), size.reshape(layout).astype(np.float32)
    )


def _levels(image: Image) -> list[Image]:
    out = [image]
    for _ in range(_LEVELS - 1):
        height, width = (max(1, n // 2) for n in out[-1].shape[:2])
        half = cv2.resize(out[-1], (width, height), interpolation=cv2.INTER_AREA)
        out.append(np.asarray(half, np.uint8))
    return out
