"""The losses of phase two: against matching and refinement, finite differences, known answers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from fewview.config import RefinementConfig
from fewview.geometry import se3
from fewview.matching.consistency import CandidateMatches, consistency_matrix
from fewview.refinement import regression
from fewview.refinement.relations import Relations
from fewview.training import consistency, regression_energy, regression_loss, spectral_loss
from fewview.training.consistency import Entries, SpectralProblem
from fewview.training.regression_energy import FeaturePairs, RegressionProblem
from fewview.types import Array, Scales, Surface
from parameters.learn import Descent, learned

KINDS = {
    "points": Scales(0.10, 0.30, 0.30, 0.02),
    "planes": Scales(0.25, 0.20, 0.50, 0.50, fixed_point=False),
}
TURN = np.array([0.0, 0.0, 0.7, 0.4, -0.3, 0.2])


def units(rng: np.random.Generator, count: int) -> Array:
    vectors = rng.normal(size=(count, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def candidates(
    rng: np.random.Generator, right: int, wrong: int, noise_m: float, levelled: bool = False
) -> CandidateMatches:
    """Matches of two kinds: ``right`` ones follow a turn about the vertical, the rest nothing."""
    pose, count = se3.exp(TURN), right + wrong
    p, n = rng.uniform(-2, 2, (count, 3)), units(rng, count)
    q, m = se3.transform(pose, p), se3.rotate(pose, n)
    q[:right] += rng.normal(scale=noise_m, size=(right, 3))
    q[right:], m[right:] = rng.uniform(-2, 2, (wrong, 3)), units(rng, wrong)
    n[::7] = 0.0
    kind = np.arange(count) % 2
    indices = np.stack([np.arange(count), np.arange(count)], axis=1)
    indices[3] = indices[1]
    similarity = rng.uniform(0.3, 1.0, count).astype(np.float32)
    up = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]) if levelled else None
    return CandidateMatches(p, q, n, m, similarity, KINDS, kind, indices, up)


def dense(entries: Entries, size: int) -> Array:
    out = torch.zeros(size, size, dtype=entries.value.dtype)
    out[entries.row, entries.column] = entries.value
    return (out + out.T).detach().numpy()


def central(function: Callable[[float], Tensor], step: float) -> Tensor:
    return (function(step) - function(-step)) / (2.0 * step)


@pytest.mark.parametrize("levelled", [False, True])
def test_consistency_is_that_of_matching(levelled: bool) -> None:
    matches = candidates(np.random.default_rng(0), 40, 60, 0.03, levelled)
    problem = SpectralProblem.of(matches, np.arange(100) < 40, torch.float64)
    gammas = spectral_loss.gammas_of(KINDS, torch.float64)
    found = dense(consistency.consistency(problem, gammas, 0.0), 100)
    expected = consistency_matrix(matches).toarray()
    assert (expected > 0).sum() > 500
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_gammas_are_put_back_where_they_came_from() -> None:
    gammas = spectral_loss.gammas_of(KINDS, torch.float64)
    assert spectral_loss.with_gammas(KINDS, gammas) == KINDS
    doubled = {name: 2.0 * value for name, value in gammas.items()}
    changed = spectral_loss.with_gammas(KINDS, doubled)
    assert changed["planes"] == replace(
        KINDS["planes"], length_m=0.5, normal_angle=0.4, direction_angle=1.0
    )


@pytest.mark.parametrize("levelled", [False, True])
def test_gradient_of_the_spectral_loss(levelled: bool) -> None:
    matches = candidates(np.random.default_rng(1), 30, 50, 0.05, levelled)
    problem = SpectralProblem.of(matches, np.arange(80) < 30, torch.float64)
    gammas = spectral_loss.gammas_of(KINDS, torch.float64)
    for value in gammas.values():
        value.requires_grad_()
    loss = spectral_loss.spectral_loss(problem, gammas)
    assert -1.0 <= loss.item() <= 1.0
    slopes = torch.autograd.grad(loss, list(gammas.values()))
    for (name, value), slope in zip(gammas.items(), slopes, strict=True):
        for k in range(3):

            def moved(step: float, name: str = name, value: Tensor = value, k: int = k) -> Tensor:
                there = value.detach().clone()
                there[k] += step
                return spectral_loss.spectral_loss(problem, {**gammas, name: there}).detach()

            numeric = central(moved, 1e-6)
            torch.testing.assert_close(slope[k], numeric, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("levelled", [False, True])
def test_features_get_a_gradient_too(levelled: bool) -> None:
    matches = candidates(np.random.default_rng(9), 20, 20, 0.05, levelled)
    matches.target_normals[4], matches.target_normals[5] = [0, 0, 1], [1, 0, 0]
    matches.target_normals[6] = [1, 0, 0]
    problem = SpectralProblem.of(matches, np.arange(40) < 20, torch.float64)
    inputs = [problem.target, problem.target_normals, problem.similarity]
    for tensor in inputs:
        tensor.requires_grad_()
    loss = spectral_loss.spectral_loss(problem, spectral_loss.gammas_of(KINDS, torch.float64))
    for slope in torch.autograd.grad(loss, inputs):
        assert slope.isfinite().all() and slope.abs().max() > 0.0


def test_spectral_loss_is_least_where_the_indicator_is_the_top_eigenvector() -> None:
    """Right matches that agree exactly and wrong ones of which none agrees with anything; then
    with a second, smaller set of matches that agree with each other."""
    rng = np.random.default_rng(2)
    p, n = rng.uniform(-2, 2, (30, 3)), units(rng, 30)
    scattered = CandidateMatches(
        p,
        se3.transform(se3.exp(TURN), p),
        n,
        se3.rotate(se3.exp(TURN), n),
        np.full(30, 0.4, np.float32),
        {"points": Scales(1e-3, 0.01, 0.01, 0.02)},
        np.zeros(30, np.int64),
        np.stack([np.arange(30)] * 2, axis=1),
    )
    scattered.target[20:] = rng.uniform(-20, 20, (10, 3))
    gammas = spectral_loss.gammas_of(scattered.kinds, torch.float64)
    right = np.arange(30) < 20

    def loss(matches: CandidateMatches, right: np.ndarray) -> float:
        problem = SpectralProblem.of(matches, right, torch.float64)
        return spectral_loss.spectral_loss(problem, gammas).item()

    assert loss(scattered, right) == pytest.approx(-1.0, abs=1e-4)
    weaker = replace(scattered, similarity=0.1 * scattered.similarity)
    assert loss(weaker, right) == pytest.approx(loss(scattered, right), abs=1e-4)
    others = [np.arange(30) < 15, np.arange(30) < 25, ~right]
    assert all(loss(scattered, other) > -0.95 for other in others)


def test_learning_recovers_the_noise_of_the_matches() -> None:
    """Positions off by s along each axis change lengths by sqrt(2) s. Where only lengths tell right
    from wrong, so large their scale becomes, whether it began far below or far above."""
    rng, noise_m = np.random.default_rng(3), 0.05
    problems = []
    for _ in range(3):
        matches = candidates(rng, 40, 160, noise_m)
        bare, alike = np.zeros((200, 3)), np.full(200, 0.8, np.float32)
        matches = replace(matches, source_normals=bare, target_normals=bare, similarity=alike)
        problems.append(SpectralProblem.of(matches, np.arange(200) < 40))
    for factor in (0.5, 4.0):
        start = dict.fromkeys(KINDS, torch.tensor([factor * noise_m, 0.3, 0.3]))
        found = learned(spectral_loss.spectral_loss, problems, start, Descent(30, 1, 0.2, 0))
        for gamma in found.values():
            assert gamma[0].item() == pytest.approx(np.sqrt(2.0) * noise_m, rel=0.5)
            assert gamma[1:].tolist() == pytest.approx([0.3, 0.3])


def refinement(
    rng: np.random.Generator,
) -> tuple[RegressionProblem, list[regression._Term], RefinementConfig]:
    """A noisy box seen twice, relations and matched features, posed near the truth."""
    config = RefinementConfig(alpha_r=0.3, alpha_0_m=0.02, alpha_match_m=0.04)
    start = se3.exp(TURN)
    inverse = se3.inverse(start)
    q, m = rng.uniform(-2, 2, (90, 3)), units(rng, 90)
    m[:60] = np.eye(3)[np.arange(60) % 3]
    p = se3.transform(inverse, q + rng.normal(scale=0.02, size=q.shape))
    n = se3.rotate(inverse, m + rng.normal(scale=0.05, size=m.shape))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    near = regression.Neighbours(
        p[None, :60], n[None, :60], q[None, :60], m[None, :60], np.ones((1, 60))
    )
    near.weight[0, ::5] = 0.0
    probability = rng.uniform(0, 1, (3, 1, 30))
    relations = Relations(p[60:], q[60:], n[60:], m[60:], rng.uniform(1, 50, 30), *probability)
    matched = rng.uniform(-2, 2, (8, 3))
    off = rng.normal(scale=0.03, size=(8, 3))
    matches = regression.Matches(
        se3.transform(inverse, matched), matched + off, (np.arange(8) != 2)[None].astype(float)
    )
    terms = list(regression._terms(start[None], near, relations, matches, config))
    columns = (near.source, near.source_normals, near.target, near.target_normals, near.weight)
    pairs = FeaturePairs.of(*(column[0] for column in columns))
    return RegressionProblem.of(start, start, pairs, relations, matches), terms, config


def test_energy_and_normal_equations_are_those_of_the_refinement() -> None:
    problem, terms, config = refinement(np.random.default_rng(4))
    scales = regression_energy.scales_of(config)
    weights = regression_energy.robust_weights(problem, scales)
    at = torch.zeros(6, dtype=torch.float64)
    rows = regression_energy.residuals(problem, at)
    for weight, row, term in zip(weights, rows, terms, strict=True):
        robust = np.broadcast_to(term.robust_weight(), term.residual.shape[:2])[0]
        expected = (robust * (term.residual[0] ** 2).sum(axis=1)).sum()
        assert float((weight * row.square().sum(dim=1)).sum()) == pytest.approx(expected)
    hessian, slope = regression_energy.normal_equations(problem, weights, at)
    expected_hessian, expected_slope = regression._normal_equations(terms)
    np.testing.assert_allclose(hessian, expected_hessian[0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(slope, expected_slope[0], rtol=1e-9, atol=1e-9)


def test_first_step_of_the_minimiser_is_that_of_the_refinement() -> None:
    problem, terms, config = refinement(np.random.default_rng(5))
    with torch.no_grad():
        found = regression_loss.minimiser(problem, regression_energy.scales_of(config))
    step = regression._gauss_newton_step(terms)[0]
    np.testing.assert_allclose(found, step, atol=2e-4)
    assert np.abs(step).max() > 2e-3


def test_gradient_of_the_regression_is_that_of_the_whole_optimisation() -> None:
    """Through alphas, relation probabilities and positions, by central differences."""
    problem, _, config = refinement(np.random.default_rng(6))
    scales = regression_energy.scales_of(config)
    inputs = [scales[name].requires_grad_() for name in regression_energy.SCALES]
    inputs += [problem.coplanar.requires_grad_(), problem.related.source.requires_grad_()]
    inputs += [problem.perpendicular.requires_grad_(), problem.near.target_normals.requires_grad_()]
    picked = torch.from_numpy(np.random.default_rng(0).normal(size=6))
    slopes = torch.autograd.grad(picked @ regression_loss.minimiser(problem, scales), inputs)
    for tensor, slope in zip(inputs, slopes, strict=True):
        flat = tensor.detach().view(-1)
        for k in {0, len(flat) // 2}:

            def moved(step: float, flat: Tensor = flat, k: int = k) -> Tensor:
                before = float(flat[k])
                flat[k] = before + step
                out = picked @ regression_loss.minimiser(problem, scales).detach()
                flat[k] = before
                return out

            numeric = central(moved, 1e-6)
            torch.testing.assert_close(slope.view(-1)[k], numeric, rtol=1e-5, atol=1e-9)


def test_regression_loss_is_nothing_where_all_agree_with_the_truth() -> None:
    rng = np.random.default_rng(7)
    problem, _, config = refinement(rng)
    start, related = problem.start, problem.related
    exact = {
        "target": related.source @ start[:3, :3].T + start[:3, 3],
        "target_normals": related.source_normals @ start[:3, :3].T,
    }
    nothing = torch.zeros_like(problem.parallel)
    agreed = replace(
        problem,
        near=replace(
            problem.near,
            target=problem.near.source @ start[:3, :3].T + start[:3, 3],
            target_normals=problem.near.source_normals @ start[:3, :3].T,
        ),
        related=replace(related, **exact),
        perpendicular=nothing,
        matched_target=problem.matched_source @ start[:3, :3].T + start[:3, 3],
    )
    scales = regression_energy.scales_of(config)
    assert regression_loss.regression_loss(agreed, scales).item() < 1e-20
    assert regression_loss.regression_loss(problem, scales).item() > 1e-6


def test_learning_trusts_the_term_that_is_right() -> None:
    """Neighbours are off by a shift, matched features are not: the first lose their say."""
    rng = np.random.default_rng(8)
    surface = box(rng)
    shifted = replace(surface, points=surface.points + 0.03)
    start = np.eye(4)
    near = regression.neighbours(
        (surface, cKDTree(surface.points)), (shifted, cKDTree(shifted.points)), start[None], 0.2
    )
    columns = (near.source, near.source_normals, near.target, near.target_normals, near.weight)
    matched = rng.uniform(-1, 1, (20, 3))
    none = np.zeros((1, 0))
    vectors = np.zeros((0, 3))
    problem = RegressionProblem.of(
        start,
        start,
        FeaturePairs.of(*(column[0] for column in columns)),
        Relations(vectors, vectors, vectors, vectors, np.zeros(0), none, none, none),
        regression.Matches(matched, matched, np.ones((1, 20))),
    )
    scales = regression_energy.scales_of(RefinementConfig())
    alpha = scales["alpha_0_m"].requires_grad_()
    loss = regression_loss.regression_loss(problem, scales)
    (slope,) = torch.autograd.grad(loss, alpha)
    assert slope > 0.0
    smaller: Mapping[str, Tensor] = {**scales, "alpha_0_m": 0.3 * alpha.detach()}
    assert regression_loss.regression_loss(problem, smaller) < loss


def box(rng: np.random.Generator) -> Surface:
    """Points on the faces of a 2 m cube, seen from inside."""
    points = rng.uniform(-1, 1, (600, 3))
    normals = np.zeros((600, 3))
    axis, side = np.arange(600) % 3, np.sign(rng.normal(size=600))
    points[np.arange(600), axis] = side
    normals[np.arange(600), axis] = -side
    return Surface(points, normals, np.zeros((600, 3), np.float32), np.full(600, -1))
