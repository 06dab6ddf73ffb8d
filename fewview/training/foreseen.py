"""Points of scans whose predicted part is the 360-image network's answer, with its gradient."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from fewview.completion.panorama.complete import CONFIDENT_ERROR
from fewview.completion.panorama.network import (
    COARSE,
    PanoramaNetwork,
    RingPrediction,
    network_input,
)
from fewview.completion.panorama.ring import ring_rays, unit
from fewview.refinement.relation_network import RelationScans


class Foreseen(NamedTuple):
    """What a network says of the points of S scans.

    Attributes:
        scans: with the network's points, normals and confidence where they are predicted.
        log_depth: (S, N) of the pixels that show the points.
        semantics: (S, N, 12) logits; descriptors: (S, N, D) unit.
    """

    scans: RelationScans
    log_depth: Tensor
    semantics: Tensor
    descriptors: Tensor


def foreseen(network: PanoramaNetwork, scans: RelationScans) -> Foreseen:
    """Ask a network about rings, in whose level frames the points must be."""
    answer: RingPrediction = network(network_input(scans.ring_colour, scans.ring_depth))
    size = scans.ring_depth.shape[1]
    pixel = scans.pixels.clamp_min(0)
    row, column = pixel // (4 * size), pixel % (4 * size)
    coarse = row // COARSE * (4 * size // COARSE) + column // COARSE
    log_depth, log_scale = (_at(x[:, None], pixel)[..., 0] for x in answer[:2])
    rays = torch.from_numpy(ring_rays(size).reshape(-1, 3)).to(pixel.device)[pixel]
    predicted = scans.predicted[..., None]
    sure = 1.0 - torch.exp(-CONFIDENT_ERROR * torch.exp(-log_scale))
    live = scans._replace(
        points=torch.where(predicted, rays * log_depth.exp()[..., None], scans.points),
        normals=torch.where(predicted, _at(answer.normal, pixel), scans.normals),
        confidence=torch.where(scans.predicted, sure, scans.confidence),
    )
    descriptors = unit(_at(answer.descriptor, coarse).mT).mT
    return Foreseen(live, log_depth, _at(answer.semantics, coarse), descriptors)


def _at(image: Tensor, pixel: Tensor) -> Tensor:
    """(S, C, H, W) at flat pixels (S, N): (S, N, C)."""
    flat = image.flatten(2)
    return flat.gather(2, pixel[:, None].expand(-1, flat.shape[1], -1)).mT
