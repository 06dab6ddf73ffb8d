"""One scan's ring completed by the shipped network; what was measured stays as it was."""

from __future__ import annotations

from functools import cache

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from fewview import weights
from fewview.completion.panorama.network import (
    COARSE,
    NORMALS,
    PanoramaNetwork,
    PanoramaNetworkConfig,
    RingPrediction,
    ring_tensors,
)
from fewview.completion.panorama.ring import unit
from fewview.types import CompletedPanorama, FloatArray, RingScan

NAME = "panorama"
CONFIDENT_ERROR = 0.1


def complete_ring(ring: RingScan, network: PanoramaNetwork | None = None) -> CompletedPanorama:
    """Predict what a scan does not show.

    Args:
        ring: the scan on the ring along its walls; see `scan_ring`.
        network: the shipped one when not given.

    Raises:
        FewviewError: the shipped weights are missing or damaged.
    """
    network = shipped_network() if network is None else network
    device = next(network.parameters()).device
    inputs = ring_tensors(ring.colour, ring.depth).to(device)
    with torch.inference_mode():
        return _kept(ring, inputs[0, NORMALS], network(inputs))


@cache
def shipped_network() -> PanoramaNetwork:
    """The network with the weights that come with the package.

    Raises:
        FewviewError: they are missing or damaged.
    """
    return weights.shipped(NAME, lambda size: PanoramaNetwork(PanoramaNetworkConfig(**size)))


def _kept(ring: RingScan, seen_normals: Tensor, answer: RingPrediction) -> CompletedPanorama:
    observed = ring.depth > 0
    seen = _image(seen_normals)
    known = np.linalg.norm(seen, axis=-1, keepdims=True) > 0.5
    scale = answer.log_scale[0].exp().cpu().numpy()
    likely = np.exp(answer.log_depth[0].cpu().numpy())
    semantics = _finer(answer.semantics[:, 1:].softmax(dim=1))
    return CompletedPanorama(
        depth=np.where(observed, ring.depth, likely),
        normals=np.where(known, seen, _image(answer.normal[0])),
        semantics=np.pad(_image(semantics[0]), ((0, 0), (0, 0), (1, 0))),
        descriptors=_image(unit(_finer(unit(answer.descriptor)))[0]),
        confidence=np.where(observed, np.float32(1), 1.0 - np.exp(-CONFIDENT_ERROR / scale)),
        observed=observed,
        level_T_scan=ring.level_T_scan,
    )


def _finer(coarse: Tensor) -> Tensor:
    """(1, C, S/2, 2 S) to (1, C, S, 4 S), linear and continuous over the seam."""
    wrapped = F.pad(coarse, (1, 1, 0, 0), mode="circular")
    return F.interpolate(wrapped, scale_factor=COARSE, mode="bilinear")[..., COARSE:-COARSE]


def _image(channels: Tensor) -> FloatArray:
    """(C, S, 4 S) to a contiguous (S, 4 S, C)."""
    return np.ascontiguousarray(channels.permute(1, 2, 0).cpu().numpy())
