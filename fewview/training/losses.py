"""Losses of the dense predictions and of the descriptors."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

SAME_PLACE_M = 0.16
TEMPERATURE = 0.1


def weighted_mean(values: Tensor, weights: Tensor) -> Tensor:
    """Mean of values under weights of the same shape; 0 when all weights are."""
    return (values * weights).sum() / weights.sum().clamp_min(1e-6)


def laplace(error: Tensor, log_scale: Tensor) -> Tensor:
    """Negative log likelihood of absolute errors under Laplace distributions, element by element.

    Kendall and Gal, "What Uncertainties Do We Need", 2017, Eq. 8 with the absolute error.
    """
    return error * torch.exp(-log_scale) + log_scale


def normal_error(predicted: Tensor, truth: Tensor) -> Tensor:
    """One minus the cosine plus the mean absolute difference of (B, 3, ...) unit normals."""
    cosine = (predicted * truth).sum(dim=1)
    return 1.0 - cosine + (predicted - truth).abs().mean(dim=1)


def semantics(logits: Tensor, truth: Tensor, class_weights: Tensor) -> Tensor:
    """Cross-entropy of (B, C, ...) logits against (B, ...) labels; label 0 is unknown."""
    return F.cross_entropy(logits, truth, class_weights, ignore_index=0)


def info_nce(source: Tensor, target: Tensor, places: Tensor, valid: Tensor) -> Tensor:
    """Each source descriptor has to find its own target among those of the other view, and back.

    van den Oord et al., "Representation Learning with Contrastive Predictive Coding", 2018, Eq. 4.

    Args:
        source: (P, n, D) unit descriptors in one view of each of P pairs.
        target: (P, n, D) of the same places in the other view.
        places: (P, n, 3) where they are; targets within 0.16 m of the place are no negatives.
        valid: (P, n) bool.
    """
    logits = source @ target.mT / TEMPERATURE
    own = torch.eye(valid.shape[1], dtype=torch.bool, device=valid.device)
    near = (torch.cdist(places, places) < SAME_PLACE_M) & ~own
    allowed = valid[:, None, :] & valid[:, :, None] & ~near
    logits = logits.masked_fill(~(allowed | own), -1e4)
    both = logits.log_softmax(dim=2) + logits.log_softmax(dim=1)
    found = both.diagonal(dim1=1, dim2=2)
    return weighted_mean(-0.5 * found, valid.to(found.dtype))
