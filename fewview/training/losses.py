"""Losses of the dense predictions and of the descriptors."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

SAME_PLACE_M = 0.16
SAME_HEIGHT_M = 0.25
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

    van den Oord et al., "Representation Learning with Contrastive Predictive Coding", 2018, Eq. 4;
    half of it with all other targets as negatives, half with those at the same height, since
    height alone tells most others apart and levelled scans need no descriptor for it.

    Args:
        source: (P, n, D) unit descriptors in one view of each of P pairs.
        target: (P, n, D) of the same places in the other view.
        places: (P, n, 3) where they are, z up; targets within 0.16 m of the place are no negatives.
        valid: (P, n) bool.
    """
    logits = source @ target.mT / TEMPERATURE
    own = torch.eye(valid.shape[1], dtype=torch.bool, device=valid.device)
    near = (torch.cdist(places, places) < SAME_PLACE_M) & ~own
    negative = valid[:, None, :] & valid[:, :, None] & ~near
    height = places[..., 2]
    level = (height[:, :, None] - height[:, None, :]).abs() < SAME_HEIGHT_M
    every, hard = _found(logits, negative | own), _found(logits, negative & level | own)
    return weighted_mean(-0.5 * (every + hard), valid.to(logits.dtype))


def _found(logits: Tensor, allowed: Tensor) -> Tensor:
    """(P, n) mean log probability of the diagonal along rows and along columns."""
    logits = logits.masked_fill(~allowed, -1e4)
    both = logits.log_softmax(dim=2) + logits.log_softmax(dim=1)
    return 0.5 * both.diagonal(dim1=1, dim2=2)
