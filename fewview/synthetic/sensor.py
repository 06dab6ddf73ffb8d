"""What a structured-light RGB-D camera makes of a perfect view."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from fewview.geometry.camera import depth_edges
from fewview.synthetic.structured_light import FOCAL_BASELINE, NOISE_PX, RANGE_M, STEP_PX
from fewview.synthetic.textures import Image, Rng, fractal
from fewview.types import BoolArray, FloatArray


@dataclass(frozen=True)
class View:
    """A perfect view.

    Attributes:
        colour: (H, W, 3) float32, 0..255 and beyond.
        depth: (H, W) float32 metres, 0 where nothing is met.
        cosine: (H, W) float32 of the angle between ray and surface normal.
    """

    colour: FloatArray
    depth: FloatArray
    cosine: FloatArray


def photograph(view: View, rng: Rng) -> Image:
    """Colour (H, W, 3) uint8 with random exposure, white balance, vignette and noise."""
    height, width = view.depth.shape
    gain = rng.uniform(0.85, 1.2) * rng.normal(1.0, 0.025, 3)
    y, x = np.linspace(-1, 1, height)[:, None], np.linspace(-1, 1, width)[None]
    vignette = (1.0 - rng.uniform(0.02, 0.08) * (x**2 + y**2)).astype(np.float32)
    image = view.colour * gain.astype(np.float32)
    image *= vignette[..., None]
    grain = rng.standard_normal(image.shape, dtype=np.float32)
    grain *= np.float32(rng.uniform(0.7, 1.3)) * (np.float32(1.5) + np.float32(0.01) * image)
    image += grain
    return np.clip(image, 0, 255, out=image).astype(np.uint8)


def measure(view: View, rng: Rng) -> FloatArray:
    """Depth (H, W) float32 in whole millimetres, 0 where it is lost."""
    near, far = RANGE_M
    depth = view.depth
    usable = (depth > near) & (depth < far)
    disparity = FOCAL_BASELINE / np.where(usable, depth, 1.0).astype(np.float32)
    disparity += np.float32(NOISE_PX) * _correlated(rng, depth.shape)
    disparity = np.maximum(np.round(disparity / STEP_PX) * STEP_PX, STEP_PX)
    noisy = np.round(FOCAL_BASELINE / disparity * 1000.0) / 1000.0
    kept = usable & (noisy > near) & (noisy < far) & ~_lost(view, rng)
    return np.where(kept, noisy, 0.0).astype(np.float32)


def _correlated(rng: Rng, shape: tuple[int, ...]) -> FloatArray:
    """(H, W) unit noise, equal within blocks of two by two pixels like a matching window's."""
    height, width = shape
    noise = rng.standard_normal((-(-height // 2), -(-width // 2)), dtype=np.float32)
    return np.repeat(np.repeat(noise, 2, axis=0), 2, axis=1)[:height, :width]


def _lost(view: View, rng: Rng) -> BoolArray:
    """Grazing surfaces, borders of objects, blotches and single pixels that give no depth."""
    shape = view.depth.shape
    chance = rng.random(shape, dtype=np.float32)
    grazing = view.cosine < 0.1 + 0.2 * chance
    edges = cv2.dilate(depth_edges(view.depth).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    blotches = fractal(rng, (shape[0], shape[1]), shape[1] / 24, 3) > 3.3
    return np.asarray(grazing | (edges & (chance < 0.6)) | blotches | (chance > 0.997))
