"""What RGB-D cameras make of the part of a ring that they see."""

from __future__ import annotations

import numpy as np

from fewview.geometry.camera import depth_edges
from fewview.synthetic.structured_light import FOCAL_BASELINE, NOISE_PX, STEP_PX
from fewview.synthetic.textures import Image, Rng
from fewview.types import BoolArray, FloatArray


def photograph_ring(colour: FloatArray, rng: Rng) -> Image:
    """Exposure, white balance and noise of each view; (V, S, 4 S, 3) 0..255 to uint8."""
    count = len(colour)
    gain = rng.uniform(0.7, 1.3, (count, 1, 1, 1)) * rng.normal(1, 0.04, (count, 1, 1, 3))
    noisy = rng.standard_normal(colour.shape, dtype=np.float32)
    noisy *= rng.uniform(0.5, 4.0, (count, 1, 1, 1)).astype(np.float32)
    noisy += colour * gain.astype(np.float32)
    return np.clip(noisy, 0, 255, out=noisy).astype(np.uint8)


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
    noise_px, seen_through = NOISE_PX * rng.uniform(0.3, 2.0), rng.uniform() < 0.5
    disparity = FOCAL_BASELINE / np.where(observed, depth, 1.0).astype(np.float32)
    disparity += np.float32(noise_px) * rng.standard_normal(depth.shape, dtype=np.float32)
    disparity = np.maximum(np.round(disparity / STEP_PX) * STEP_PX, STEP_PX)
    chance = rng.random(depth.shape, dtype=np.float32)
    edges = depth_edges(depth, 0.15)
    lost = (cosine < 0.1 + 0.2 * chance) | (edges & (chance < 0.5)) | (chance > 0.99)
    lost |= _blotches(rng, depth.shape, rng.uniform(0.0, 0.04)) | (
        glass & seen_through & (chance > 0.1)
    )
    return np.where(observed & ~lost, FOCAL_BASELINE / disparity, 0.0).astype(np.float32)


def _blotches(rng: Rng, shape: tuple[int, ...], share: float) -> BoolArray:
    """Random blocks that cover a share of an image."""
    out = np.zeros(shape, bool)
    for edge in (2, 5):
        blocks = rng.random((-(-shape[0] // edge), -(-shape[1] // edge))) < 0.5 * share
        out |= np.kron(blocks, np.ones((edge, edge), bool))[: shape[0], : shape[1]]
    return out
