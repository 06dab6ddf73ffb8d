"""The loss of the local module, l_4 of the paper (Sec. 3.4), as a function of the alphas.

One iteration of the robust regression from a pose T weights all terms by their residuals under T
and minimises the weighted energy (Eq. 5 and 6):

    E(xi) = 1/2 sum_c w_c |r_c(exp(xi) T)|^2 + 1/2 d |xi|^2,  w_c = p_c alpha^2 / (alpha^2 + f_c(T))

with d the damping of `refinement.regression` at T, which keeps a pose where nothing holds it. l_4
is the squared Frobenius norm between the true pose and exp(xi*) T; the paper starts at the truth.

The gradient of the minimiser comes from the implicit function theorem (supplementary): g = dE/dxi
vanishes at xi*, hence dxi*/dalpha = -H^-1 dg/dalpha. It is had by one Newton step from xi*, whose
value is zero and whose derivative is just that, and it reaches everything that enters g: alphas,
weights, relation probabilities, positions and normals.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from fewview.refinement.regression import DAMPING
from fewview.training.regression_energy import (
    RegressionProblem,
    exp,
    normal_equations,
    residuals,
    robust_weights,
)

MAX_STEPS = 100
CONVERGED = 1e-8


def regression_loss(problem: RegressionProblem, scales: Mapping[str, Tensor]) -> Tensor:
    """l_4 of one pair: squared Frobenius norm of a difference of (3, 4) poses, metres."""
    pose = exp(minimiser(problem, scales)) @ problem.start
    return (pose - problem.truth)[:3].square().sum()


def minimiser(problem: RegressionProblem, scales: Mapping[str, Tensor]) -> Tensor:
    """(6,) xi* of one iteration, with its gradient by the implicit function theorem where gradients
    are asked for."""
    weights = robust_weights(problem, scales)
    hold = damping(problem, weights)
    with torch.no_grad():
        xi = torch.zeros(6, dtype=torch.float64)
        for _ in range(MAX_STEPS):
            hessian, slope = normal_equations(problem, weights, xi)
            hessian = hessian + hold * torch.eye(6, dtype=torch.float64)
            step = torch.linalg.solve(hessian, slope + hold * xi)
            xi = xi - step
            if float(step.abs().max()) < CONVERGED:
                break
    if not torch.is_grad_enabled():
        return xi

    def energy(at: Tensor) -> Tensor:
        rows = residuals(problem, at)
        terms = [(w * r.square().sum(dim=1)).sum() for w, r in zip(weights, rows, strict=True)]
        return 0.5 * torch.stack(terms).sum() + 0.5 * hold * at.square().sum()

    at = xi.clone().requires_grad_()
    (slope,) = torch.autograd.grad(energy(at), at, create_graph=True)
    hessian = torch.func.hessian(energy)(xi).detach()
    found: Tensor = xi - torch.linalg.solve(hessian, slope)
    return found


def damping(problem: RegressionProblem, weights: list[Tensor]) -> Tensor:
    """What the regression adds to the diagonal of its first normal equations."""
    hessian, _ = normal_equations(problem, weights, torch.zeros(6, dtype=torch.float64))
    return DAMPING * (torch.trace(hessian) / 6.0).clamp_min(1e-9)
