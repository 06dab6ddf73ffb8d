"""Maximum pseudo-likelihood of the potentials, and then of what drawings add to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor, nn

from fewview.probability import ProbabilityModel
from fewview.together import PotentialModel
from fewview.types import Array
from potential.samples import QUANTITIES, RIGHT_DEG, RIGHT_M, Sample

HIDDEN, RIDGE, HIDDEN_RIDGE = 12, 2.0, 5.0
"""Inner units; ridges on outer and inner coefficients."""
WEIGHT, WARPED_WEIGHT, STRANGERS_WEIGHT = 0.3, 0.3, 2.0
"""What a sample counts, as the samples of a set share their scans; how much less if a warped sensor
saw them, which teaches to forgive, and how much more if there are strangers: two rooms in one
folder are not to come out as one."""
START, ITERATIONS = 0.1, 400


def fitted(samples: Sequence[Sample]) -> PotentialModel:
    """Maximum pseudo-likelihood with ridges."""
    rows = np.concatenate([s.quantities.reshape(-1, len(QUANTITIES)) for s in samples])
    mean, scale = rows.mean(axis=0), rows.std(axis=0) + 1e-6
    d = len(QUANTITIES)
    shapes = [(d,), (), (HIDDEN, d), (HIDDEN,), (HIDDEN,), ()]
    sizes = [int(np.prod(shape)) for shape in shapes]

    def parts(parameters: Tensor) -> list[Tensor]:
        return [p.reshape(s) for p, s in zip(torch.split(parameters, sizes), shapes, strict=True)]

    def model(parameters: Array) -> PotentialModel:
        w, b, u, c, v, join = (p.numpy() for p in parts(torch.from_numpy(parameters)))
        pair = ProbabilityModel(QUANTITIES, mean, scale, w, float(b), u, c, v)
        return PotentialModel(pair, float(join), drawn=0.0, typical=0.0)

    start = np.random.default_rng(0).normal(0.0, START, sum(sizes))
    start[: d + 1] = start[-1] = 0.0
    f = torch.from_numpy(model(start).pair.standard(rows))
    place, there, right = _places(samples)
    weight = torch.tensor([_weight(s) for s in samples], dtype=f.dtype)

    def loss(values: Array) -> tuple[float, Array]:
        parameters = torch.from_numpy(values).requires_grad_()
        w, b, u, c, v, join = parts(parameters)
        potential = f @ w + b + torch.tanh(f @ u.T + c) @ v
        z = torch.zeros(there.numel(), dtype=f.dtype).index_add(0, place, potential) + join
        z = nn.functional.pad(z.view_as(there).masked_fill(~there, -torch.inf), (1, 0))
        error = weight @ nn.functional.cross_entropy(z, right, reduction="none")
        error = error + RIDGE * w.square().sum() + HIDDEN_RIDGE * (u.square().sum() + v @ v)
        (slope,) = torch.autograd.grad(error, parameters)
        return error.item(), slope.numpy()

    found = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": ITERATIONS})
    return model(found.x)


def with_drawings(model: PotentialModel, samples: Sequence[Sample]) -> PotentialModel:
    """The model with what scans drawn as one count, by maximum pseudo-likelihood."""
    several = [s for s in samples if s.several]
    known = [log_odds(replace(model, drawn=0.0), s) for s in several]

    def loss(values: Array) -> float:
        weight, offset = values
        error = 0.0
        for sample, z in zip(several, known, strict=True):
            z = np.append(0.0, z + weight * sample.drawn + offset)
            error += np.logaddexp.reduce(z) - z[_right_place(sample)]
        return float(error)

    weight, offset = minimize(loss, np.zeros(2), method="L-BFGS-B").x
    return replace(model, drawn=float(weight), typical=float(-offset / weight))


def log_odds(model: PotentialModel, sample: Sample) -> Array:
    """(K,) of each place."""
    m, count, d = sample.quantities.shape
    f = model.pair.standard(sample.quantities.reshape(-1, d))
    z = model.pair.logits_of(f).reshape(m, count).sum(axis=0) + model.join
    if sample.several:
        z = z + model.drawn * (sample.drawn - model.typical)
    return np.asarray(z)


def probabilities(model: PotentialModel, sample: Sample) -> Array:
    """(1 + K,) of none and of each place."""
    z = np.append(0.0, log_odds(model, sample))
    return np.asarray(np.exp(z - np.logaddexp.reduce(z)))


def _weight(sample: Sample) -> float:
    strangers = STRANGERS_WEIGHT if "strangers" in sample.kind else 1.0
    return WEIGHT * strangers * (WARPED_WEIGHT if sample.warped else 1.0)


def _right_place(sample: Sample) -> int:
    """The right place that is nearest to the truth, from 1 on; 0 for none."""
    if not sample.right.any():
        return 0
    error = sample.turns_deg / RIGHT_DEG + sample.shifts_m / RIGHT_M
    return 1 + int(np.where(sample.right, error, np.inf).argmin())


def _places(samples: Sequence[Sample]) -> tuple[Tensor, Tensor, Tensor]:
    """The place, of S K in all, of every pair in the samples' quantities; which places there are
    (S, K); and the right one (S,) from 1 on, 0 for none."""
    counts = np.array([s.quantities.shape[1] for s in samples])
    most = counts.max()
    place = [
        np.tile(k * most + np.arange(count), len(sample.quantities))
        for k, (sample, count) in enumerate(zip(samples, counts, strict=True))
    ]
    right = torch.tensor([_right_place(sample) for sample in samples])
    there = torch.from_numpy(np.arange(most) < counts[:, None])
    return torch.from_numpy(np.concatenate(place)), there, right
