"""What RGB-D cameras make of the part of a ring that they see."""

from __future__ import annotations

import numpy as np

from fewview.geometry.camera import depth_edges
from fewview.synthetic.structured_light import FOCAL_BASELINE, NOISE_PX, STEP_PX
from fewview.synthetic.textures import Image, Rng
from fewview.types import BoolArray, FloatArray


def photograph_ring(colour: FloatArray, rng: Rng) -> Image:
    """What one camera of any make gives of all views of a room.

    Contrast, saturation and white balance are the camera's and may be far from true; its automatic
    exposure and white balance change them a little from view to view, exposure at times by much.

    Args:
        colour: (V, S, 4 S, 3) float32, 0..255 and beyond.
        rng: source of chance.

    Returns:
        (V, S, 4 S, 3) uint8.
    """
    grain = rng.standard_normal(colour.shape[1:], dtype=np.float32)
    out = np.empty(colour.shape, np.uint8)
    contrast, saturation = rng.uniform(0.5, 2.0), rng.uniform(0.4, 1.6)
    balance = rng.uniform(0.7, 1.3) * rng.normal(1, 0.04, 3)
    middle = float(colour.mean())
    for view, picture in zip(out, colour, strict=True):
        gain = rng.uniform(0.85, 1.2) if rng.uniform() < 0.8 else rng.uniform(0.6, 1.5)
        own_contrast = contrast * rng.uniform(0.9, 1.1)
        own_saturation = saturation * rng.uniform(0.9, 1.1)
        own_balance = balance * gain * rng.normal(1, 0.025, 3)
        mixing = own_saturation * np.eye(3) + (1 - own_saturation) / 3
        image = picture @ (own_contrast * mixing * own_balance).astype(np.float32)
        image += ((1 - own_contrast) * middle * own_balance).astype(np.float32)
        shift = int(rng.integers(grain.shape[1]))
        image += np.float32(rng.uniform(0.2, 2.5)) * np.roll(grain, shift, axis=1)
        view[:] = np.clip(image, 0, 255, out=image)
    return out


def measure_ring(
    depth: FloatArray,
    observed: BoolArray,
    cosine: FloatArray,
    glass: BoolArray,
    dark: BoolArray,
    rng: Rng,
) -> FloatArray:
    """What sensors of various make give on the pixels of a ring.

    A ring's pixel is the mean of several of the sensor's, so most of their noise is gone.

    Args:
        depth: (S, 4 S) metres along the camera's axis.
        observed: (S, 4 S) where the camera looks and reaches.
        cosine: (S, 4 S) of the angle between ray and surface normal.
        glass: (S, 4 S) window panes; half of the cameras see nothing there.
        dark: (S, 4 S) surfaces that swallow light; half of the cameras lose most of them.
        rng: source of noise.

    Returns:
        (S, 4 S) metres along the camera's axis, 0 where it is lost.
    """
    noise_px, step_px = (scale * rng.uniform(0.1, 1.0) for scale in (NOISE_PX, STEP_PX))
    least = rng.uniform(0.03, 0.2)
    disparity = FOCAL_BASELINE / np.where(observed, depth, 1.0).astype(np.float32)
    disparity += np.float32(noise_px) * rng.standard_normal(depth.shape, dtype=np.float32)
    disparity = np.maximum(np.round(disparity / step_px) * step_px, step_px)
    chance = rng.random(depth.shape, dtype=np.float32)
    lost = (cosine < least + 0.2 * chance) | (chance > rng.uniform(0.95, 1.0))
    lost |= depth_edges(depth, 0.15) & (chance < rng.uniform(0.2, 0.9))
    lost |= _blotches(rng, depth.shape, 0.4 * rng.uniform() ** 2)
    lost |= (glass & (rng.uniform() < 0.5) & (chance > 0.1)) | (
        dark & (rng.uniform() < 0.5) & (chance > 0.3)
    )
    return np.where(observed & ~lost, FOCAL_BASELINE / disparity, 0.0).astype(np.float32)


def _blotches(rng: Rng, shape: tuple[int, ...], share: float) -> BoolArray:
    """Random blocks of several sizes that cover a share of an image."""
    out = np.zeros(shape, bool)
    for edge in (2, 4, 8):
        blocks = rng.random((-(-shape[0] // edge), -(-shape[1] // edge))) < share / 3
        out |= blocks.repeat(edge, axis=0).repeat(edge, axis=1)[: shape[0], : shape[1]]
    return out
