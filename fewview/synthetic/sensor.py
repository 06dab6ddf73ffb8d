"""What a structured-light RGB-D camera makes of a perfect view.

Axial noise grows with the square of the depth because disparity is what is measured; the deviation
of 0.0014 z^2 and the 1/8 pixel steps are those of Khoshelham and Elberink, "Accuracy and Resolution
of Kinect Depth Data" (Sensors 2012).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from fewview.geometry.camera import depth_edges
from fewview.synthetic.textures import Image, Rng, fractal
from fewview.types import BoolArray, FloatArray

RANGE_M = (0.4, 5.0)
"""Nearest and farthest depth that is measured."""

_FOCAL_BASELINE = 43.5
_STEP_PX = 0.125
_NOISE_PX = 0.049


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
    disparity = _FOCAL_BASELINE / np.where(usable, depth, 1.0).astype(np.float32)
    disparity += np.float32(_NOISE_PX) * _correlated(rng, depth.shape)
    disparity = np.maximum(np.round(disparity / _STEP_PX) * _STEP_PX, _STEP_PX)
    noisy = np.round(_FOCAL_BASELINE / disparity * 1000.0) / 1000.0
    kept = usable & (noisy > near) & (noisy < far) & ~_lost(view, rng)
    return np.where(kept, noisy, 0.0).astype(np.float32)


def measure_ring(
    depth: FloatArray, observed: BoolArray, cosine: FloatArray, glass: BoolArray, rng: Rng
) -> FloatArray:
    """What sensors of various make give on the pixels of a ring.

    A ring's pixel stands for one of the sensor's, so the noise is that of a single one.

    Args:
        depth: (S, 4 S) metres along the camera's axis.
        observed: (S, 4 S) where the camera looks and reaches.
        cosine: (S, 4 S) of the angle between ray and surface normal.
        glass: (S, 4 S) window panes; half of the cameras see nothing there.
        rng: source of noise.

    Returns:
        (S, 4 S) metres along the camera's axis, 0 where it is lost.
    """
    noise_px, seen_through = _NOISE_PX * rng.uniform(0.3, 2.0), rng.uniform() < 0.5
    disparity = _FOCAL_BASELINE / np.where(observed, depth, 1.0).astype(np.float32)
    disparity += np.float32(noise_px) * rng.standard_normal(depth.shape, dtype=np.float32)
    disparity = np.maximum(np.round(disparity / _STEP_PX) * _STEP_PX, _STEP_PX)
    chance = rng.random(depth.shape, dtype=np.float32)
    edges = depth_edges(depth, 0.15)
    blotches = fractal(rng, (depth.shape[0], depth.shape[1]), depth.shape[1] / 16, 3)
    lost = (cosine < 0.1 + 0.2 * chance) | (edges & (chance < 0.5)) | (chance > 0.99)
    lost |= (blotches > rng.uniform(2.0, 4.0)) | (glass & seen_through & (chance > 0.1))
    return np.where(observed & ~lost, _FOCAL_BASELINE / disparity, 0.0).astype(np.float32)


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
