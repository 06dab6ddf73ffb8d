"""What the look of the joint room adds to the aligner's scores of a pair's candidates."""

from __future__ import annotations

from functools import cache

import numpy as np
import torch

from fewview import weights
from fewview.alignment import Drawing, planar_motion
from fewview.types import Array
from fewview.verification.network import VerifierNetwork, VerifierNetworkConfig, together

NAME = "verifier"


@cache
def shipped_network() -> VerifierNetwork:
    """The network with the weights that come with the package.

    Raises:
        FewviewError: they are missing or damaged.
    """
    return weights.shipped(NAME, lambda size: VerifierNetwork(VerifierNetworkConfig(**size)))


def plausibility(
    source: Drawing,
    target: Drawing,
    target_T_source: Array,
    network: VerifierNetwork | None = None,
) -> Array:
    """(K,) to be added to the aligner's log probabilities; the logit of a right pose is the sum.

    Args:
        source, target: the scans from above.
        target_T_source: (K, 4, 4); what they tilt and lift is left out.
        network: the shipped one when not given.

    Raises:
        FewviewError: the shipped weights are missing or damaged.
    """
    if not len(target_T_source):
        return np.zeros(0)
    network = shipped_network() if network is None else network
    motion = torch.from_numpy(planar_motion(source, target, target_T_source))
    count = len(motion)
    first, second = (
        torch.from_numpy(drawing.channels)[None].expand(count, -1, -1, -1)
        for drawing in (source, target)
    )
    with torch.inference_mode():
        logits = network(together(first, second, motion))
    return np.asarray(logits.numpy(), dtype=np.float64)
