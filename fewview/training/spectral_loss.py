"""The loss of spectral matching, l_3 of the paper (Sec. 3.4), as a function of the gammas.

The normalised indicator u of the right correspondences should be the top eigenvector of the
consistency matrix C. The paper sums |C u - (u'C u) u|^2 - u'C u over pairs, where the first term
grows with the square of C and the second with C. The more correspondences there are and the more
alike their descriptors, the more the first prevails, and it is least where nothing is consistent:
on pairs of generated rooms the sum falls as all gammas go to zero. Where hardly anything is wrong
it falls as they go to infinity. Here C is divided by its largest eigenvalue e:

    l_3 = |C u - (u'C u) u|^2 / e^2 - u'C u / e

lies between -1 and 1, does not change when C is scaled, and is -1 exactly when u is a top
eigenvector: the three properties that the paper asks for, and vanishing gammas gain nothing.
The derivative of e is that of v'C v with its eigenvector v held fixed (Hellmann and Feynman), so no
power iteration has to be differentiated either.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import torch
from scipy import sparse
from scipy.sparse.linalg import eigsh
from torch import Tensor

from fewview.training.consistency import Entries, SpectralProblem, consistency
from fewview.types import Scales

GAMMAS = ("length_m", "normal_angle", "direction_angle")
"""The `Scales` that l_3 trains: gamma_2, gamma_3, and gamma_4 = gamma_5."""
FADE = 0.02
"""Width over which entries fade out that matching sets to zero, as a share of the largest."""


def gammas_of(kinds: Mapping[str, Scales], dtype: torch.dtype = torch.float32) -> dict[str, Tensor]:
    """The `GAMMAS` (3,) of each kind."""
    return {
        name: torch.tensor([getattr(scales, g) for g in GAMMAS], dtype=dtype)
        for name, scales in kinds.items()
    }


def with_gammas(kinds: Mapping[str, Scales], gammas: Mapping[str, Tensor]) -> Mapping[str, Scales]:
    """The kinds with other `GAMMAS`."""
    return {
        name: replace(scales, **dict(zip(GAMMAS, gammas[name].tolist(), strict=True)))
        for name, scales in kinds.items()
    }


def spectral_loss(problem: SpectralProblem, gammas: Mapping[str, Tensor]) -> Tensor:
    """l_3 of one pair, in -1..1; 0 where no correspondences agree with each other."""
    matrix = consistency(problem, gammas, FADE)
    if not len(matrix.value):
        return matrix.value.sum()
    indicator = problem.right.to(matrix.value.dtype)
    indicator = indicator / indicator.norm()
    top = top_eigenvector(matrix, len(indicator))
    largest = top @ matrix.times(top)
    image = matrix.times(indicator)
    along = indicator @ image
    rest = image - along * indicator
    loss: Tensor = rest.square().sum() / largest.square() - along / largest
    return loss


def top_eigenvector(matrix: Entries, size: int) -> Tensor:
    """(m,) of unit length, of the largest eigenvalue; no gradient goes through it."""
    i, j, value = (part.detach().numpy() for part in (matrix.row, matrix.column, matrix.value))
    upper = sparse.csr_matrix((value.astype(np.float64), (i, j)), shape=(size, size))
    _, vectors = eigsh(upper + upper.T, k=1, which="LA", v0=np.ones(size))
    return torch.from_numpy(vectors[:, 0]).to(matrix.value.dtype)
