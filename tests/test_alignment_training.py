"""The aligner and the verifier as training problems."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from box_rooms import box_room

from fewview import weights
from fewview.alignment import AlignerNetwork, AlignerNetworkConfig
from fewview.completion.layout.network import LayoutNetwork, LayoutNetworkConfig
from fewview.training.aligner import AlignerProblem
from fewview.training.drawn_rooms import drawn_rooms
from fewview.training.problem import Batch, Problem
from fewview.training.verifier import VerifierProblem
from fewview.verification import VerifierNetworkConfig

LAYOUT = LayoutNetworkConfig(width=8, point_features=8)
ALIGNER = AlignerNetworkConfig(width=8, channels=4)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Weights that have learnt nothing."""
    out: Path = tmp_path_factory.mktemp("weights")
    torch.manual_seed(0)
    for name, network in (("layout", LayoutNetwork(LAYOUT)), ("aligner", AlignerNetwork(ALIGNER))):
        size = dataclasses.asdict(network.config)
        weights.save(name, out, network.state_dict(), {"config": {"settings": {"size": size}}})
    return str(out)


def batch_of(problem: Problem, seed: int = 0) -> Batch:
    rooms = [box_room(i, views=3) for i in range(2)]
    return problem.batch(rooms, np.random.default_rng(seed))


def test_what_a_view_shares_with_itself(folder: str) -> None:
    drawn = drawn_rooms([box_room(0, views=2)], folder, 0.0, np.random.default_rng(0))
    assert drawn.shared(1, 1) == 1.0
    assert drawn.shared(0, 1) < 1.0
    np.testing.assert_allclose(drawn.target_T_source(1, 1), np.eye(4), atol=1e-9)


def test_the_aligner_is_taught_the_true_pose(folder: str) -> None:
    batch = batch_of(AlignerProblem(ALIGNER, folder))
    there = {
        (int(a), int(b)): i
        for i, (a, b) in enumerate(zip(batch["source"], batch["target"], strict=True))
    }
    assert all(a // 3 == b // 3 for a, b in there)
    for (a, b), i in there.items():
        back = there[b, a]
        assert (batch["yaw"][i] + batch["yaw"][back]) % 4 == 0
        distance = batch["shift"][[i, back]].norm(dim=1)
        torch.testing.assert_close(distance[0], distance[1], rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("name", ["aligner", "verifier"])
def test_losses_fall_and_figures_are_shares_and_errors(folder: str, name: str) -> None:
    torch.manual_seed(0)
    problem: Problem = AlignerProblem(ALIGNER, folder)
    if name == "verifier":
        problem = VerifierProblem(VerifierNetworkConfig(width=16), folder, pairs=4, candidates=3)
    network, batch = problem.network(), batch_of(problem)
    optimiser = torch.optim.Adam(network.parameters(), 3e-3)
    values = []
    for _ in range(12):
        (loss,) = problem.losses(network, batch).values()
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        values.append(float(loss.detach()))
    assert values[-1] < 0.9 * values[0]
    with torch.inference_mode():
        figures = problem.metrics(network.eval(), batch)
    shares = [v for k, v in figures.items() if not k.endswith(("deg", "_m")) and np.isfinite(v)]
    assert shares
    assert all(0.0 <= v <= 1.0 for v in shares)


def test_some_pairs_of_the_verifier_have_no_right_candidate(folder: str) -> None:
    problem = VerifierProblem(VerifierNetworkConfig(width=16), folder, pairs=6, hidden=0.5)
    batch = batch_of(problem)
    assert batch["right"][:, -2].all()
    assert not batch["right"][:, -1].any()
    asked = batch["asked"] & batch["right"]
    assert asked.any(dim=1).any()
    assert not asked.any(dim=1).all()
