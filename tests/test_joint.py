"""Phase three: predicted points that carry gradients, what l_3 and l_4 see, and a run."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from box_rooms import box_room

from fewview import weights
from fewview.completion.panorama.network import PanoramaNetwork, PanoramaNetworkConfig
from fewview.completion.panorama.ring import ring_points
from fewview.config import RefinementConfig
from fewview.geometry import se3
from fewview.refinement.relation_network import RelationNetwork, RelationNetworkConfig
from fewview.training import joint_pairs
from fewview.training.foreseen import foreseen
from fewview.training.joint import JointNetwork, JointProblem
from fewview.training.problem import Batch
from fewview.training.regression_energy import scales_of
from fewview.training.regression_loss import regression_loss
from fewview.training.relation import RelationProblem, given
from fewview.training.relation_rooms import sampled

SMALL = RelationNetworkConfig(local=16, whole=32, image=8, head=16)
RELATION = RelationProblem(SMALL, seen=96, predicted=32, pairs=4, relations=64, tilt_deg=0.0)
SIZE = 64


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(0)
    folder = tmp_path_factory.mktemp("weights")
    panorama = PanoramaNetwork(PanoramaNetworkConfig(width=16, descriptor=8))
    for name, network in (("panorama", panorama), ("relation", RelationNetwork(SMALL))):
        size = dataclasses.asdict(network.config)
        card = {"config": {"settings": {"size": size}}}
        weights.save(name, folder, network.state_dict(), card)
    return folder


@pytest.fixture
def problem(folder: Path) -> JointProblem:
    return JointProblem(RELATION, weights=str(folder))


@pytest.fixture
def network(problem: JointProblem) -> JointNetwork:
    network = problem.network()
    assert isinstance(network, JointNetwork)
    return network


@pytest.fixture
def batch(problem: JointProblem, network: JointNetwork) -> Batch:
    rng = np.random.default_rng(0)
    rooms = [sampled(box_room(i, 3, SIZE), network.panorama.eval(), rng) for i in range(2)]
    return problem.batch(rooms, rng)


def test_only_predicted_points_are_the_networks(network: JointNetwork, batch: Batch) -> None:
    scans = given(batch)[0]
    live = foreseen(network.panorama, scans).scans
    seen = ~scans.predicted
    for name in ("points", "normals", "confidence"):
        torch.testing.assert_close(getattr(live, name)[seen], getattr(scans, name)[seen])
    there = scans.predicted & scans.pooled
    torch.testing.assert_close(live.points[there], scans.points[there], atol=0.02, rtol=0.01)
    torch.testing.assert_close(live.confidence[there], scans.confidence[there], atol=0.01, rtol=0.1)
    assert live.points.requires_grad and not scans.points.requires_grad


def test_depth_of_points_is_that_of_their_ring() -> None:
    depth = np.random.default_rng(1).uniform(0.5, 4.0, (SIZE, 4 * SIZE)).astype(np.float32)
    found = joint_pairs.log_depth(torch.from_numpy(ring_points(depth)))
    np.testing.assert_allclose(found.exp(), depth, rtol=1e-5)


def test_all_losses_reach_what_they_are_of(
    problem: JointProblem, network: JointNetwork, batch: Batch
) -> None:
    for value in problem.losses(network, batch).values():
        assert torch.isfinite(value)
    torch.stack(list(problem.losses(network, batch).values())).sum().backward()  # type: ignore[no-untyped-call]
    for parameter in (
        network.log_alphas,
        network.relation.own.weight,
        network.panorama.geometry.weight,
    ):
        assert parameter.grad is not None and parameter.grad.abs().sum() > 0


def test_the_regression_reaches_relations_and_predicted_points(
    network: JointNetwork, batch: Batch
) -> None:
    scans, pairs = given(batch)
    seen = foreseen(network.panorama, scans)
    output = network.relation(seen.scans, pairs)
    output.relations.retain_grad()
    problems = list(joint_pairs.regression_problems(seen, output, batch, 2))
    loss = torch.stack([regression_loss(p, scales_of(RefinementConfig())) for p in problems]).sum()
    loss.backward()  # type: ignore[no-untyped-call]
    assert output.relations.grad is not None
    assert output.relations.grad[:2].abs().sum() > 0 and not output.relations.grad[2:].any()
    assert network.panorama.geometry.weight.grad is not None


def test_right_matches_are_those_that_the_truth_explains(
    network: JointNetwork, batch: Batch
) -> None:
    seen = foreseen(network.panorama, given(batch)[0])
    views, descriptors = len(seen.descriptors), seen.descriptors.shape[1]
    same = torch.nn.functional.normalize(torch.randn(descriptors, 8), dim=1)
    with torch.no_grad():
        alike = seen._replace(descriptors=same.expand(views, -1, -1))
        itself = {
            "source": torch.zeros(1, dtype=torch.int64),
            "target": torch.zeros(1, dtype=torch.int64),
            "true_pose": torch.eye(4)[None],
        }
        [problem] = joint_pairs.spectral_problems(alike, itself)
        assert problem.right.sum() >= 20
        off = (problem.source - problem.target).norm(dim=1)
        assert (off[problem.right] < 0.25).all() and (off[~problem.right] >= 0.25).all()
        away = torch.from_numpy(se3.exp(np.array([0, 0, 0, 9.0, 0, 0]))).float()
        far = {**itself, "true_pose": away[None]}
        assert not list(joint_pairs.spectral_problems(alike, far))


def test_figures_and_losses_without_gradients(
    problem: JointProblem, network: JointNetwork, batch: Batch
) -> None:
    network.eval()
    with torch.inference_mode():
        found = problem.metrics(network, batch)
    assert {"completion_loss", "regression_loss", "log_depth", "seen_mean"} <= found.keys()
    assert found["log_depth"] > 0.0 and 0.0 <= found["semantics_accuracy"] <= 1.0


def test_steps_lower_the_loss(problem: JointProblem, network: JointNetwork, batch: Batch) -> None:
    network.train()
    optimiser = torch.optim.Adam(network.parameters(), 1e-3)
    found = []
    for _ in range(8):
        loss = torch.stack(list(problem.losses(network, batch).values())).sum()
        found.append(float(loss.detach()))
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
    assert found[-1] < 0.95 * found[0]
