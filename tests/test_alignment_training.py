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
from fewview.alignment.drawing import OBSERVED
from fewview.completion.layout.network import LayoutNetwork, LayoutNetworkConfig
from fewview.synthetic import Split
from fewview.training import loop, rooms
from fewview.training.aligner import AlignerProblem
from fewview.training.drawn_rooms import DrawnRooms, drawing_fingerprint, drawn, mirrored
from fewview.training.problem import Batch, Problem
from fewview.training.settings import TrainConfig
from fewview.training.verifier import VerifierProblem
from fewview.verification import VerifierNetworkConfig

LAYOUT = LayoutNetworkConfig(width=8, point_features=8)
ALIGNER = AlignerNetworkConfig(width=8, channels=4)
VERIFIER = VerifierNetworkConfig(width=16)


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
    source = problem.prepared(lambda split, index, views, size: box_room(index, views=views))
    rooms = [source("train", i, 3, 64) for i in range(2)]
    return problem.batch(rooms, np.random.default_rng(seed))


def test_what_views_share(folder: str) -> None:
    room = drawn(box_room(0, views=3), Path(folder), 0.0, np.random.default_rng(0))
    np.testing.assert_array_equal(np.diag(room.shared), 1.0)
    np.testing.assert_array_equal(room.shared, room.shared.T)
    assert room.shared.min() < 1.0
    last_two = dataclasses.replace(room, **{name: array[1:] for name, array in vars(room).items()})
    both = DrawnRooms([room, last_two])
    assert both.apart(3, 4) == both.apart(1, 2) == (room.shared[1, 2] < 0.1)
    np.testing.assert_array_equal(both.room, [0, 0, 0, 1, 1])
    np.testing.assert_allclose(both.target_T_source(1, 3), np.eye(4), atol=1e-9)


def test_a_mirrored_drawing_is_that_of_the_mirrored_room(folder: str) -> None:
    problem = AlignerProblem(size=ALIGNER, weights=folder)
    room = drawn(box_room(0, views=2), Path(folder), 0.0, np.random.default_rng(0))
    batches = [problem.batch([r], np.random.default_rng(0)) for r in (room, mirrored(room))]
    plain, turned = batches
    torch.testing.assert_close(turned["drawing"], plain["drawing"].flip(3))
    torch.testing.assert_close(turned["shift"], plain["shift"] * torch.tensor([1.0, -1.0]))
    assert ((plain["yaw"] + turned["yaw"]) % 4 == 0).all()
    twice = mirrored(mirrored(room))
    np.testing.assert_allclose(twice.grid_T_level, room.grid_T_level, atol=1e-12)


def test_other_weights_make_other_drawings(folder: str, tmp_path: Path) -> None:
    first = drawing_fingerprint(Path(folder), 1.0)
    assert first == drawing_fingerprint(Path(folder), 1.0)
    assert first != drawing_fingerprint(Path(folder), 2.0)
    (tmp_path / "layout.safetensors").write_bytes(b"other")
    assert first != drawing_fingerprint(tmp_path, 1.0)


def test_the_aligner_is_taught_the_true_pose(folder: str) -> None:
    batch = batch_of(AlignerProblem(size=ALIGNER, weights=folder))
    there = {
        (int(a), int(b)): i
        for i, (a, b) in enumerate(zip(batch["source"], batch["target"], strict=True))
        if not batch["joint"][i]
    }
    assert there
    assert all(a // 3 == b // 3 for a, b in there)
    for (a, b), i in there.items():
        back = there[b, a]
        assert (batch["yaw"][i] + batch["yaw"][back]) % 4 == 0
        distance = batch["shift"][[i, back]].norm(dim=1)
        torch.testing.assert_close(distance[0], distance[1], rtol=1e-3, atol=1e-3)


def test_a_target_of_several_views_never_shows_the_source(folder: str) -> None:
    problem = AlignerProblem(size=ALIGNER, weights=folder, joint=3, together=1)
    batch = batch_of(problem)
    joint = batch["joint"]
    assert joint.any() and not joint.all()
    assert (batch["room"][batch["source"]] == batch["room"][batch["target"]]).all()
    observed = batch["drawing"][:, OBSERVED] > 0
    for i in torch.nonzero(joint)[:, 0]:
        group, source = int(batch["target"][i]), int(batch["source"][i])
        alone = [
            v
            for v in range(6)
            if batch["room"][v] == batch["room"][group]
            and not (observed[v] & ~observed[group]).any()
        ]
        assert alone and source not in alone


@pytest.mark.parametrize("name", ["aligner", "verifier"])
def test_losses_fall_and_figures_are_shares_and_errors(folder: str, name: str) -> None:
    torch.manual_seed(0)
    problem: Problem = AlignerProblem(size=ALIGNER, weights=folder)
    if name == "verifier":
        problem = VerifierProblem(
            size=VerifierNetworkConfig(width=16), weights=folder, pairs=4, candidates=3
        )
    network, batch = problem.network(), batch_of(problem)
    optimiser = torch.optim.Adam(network.parameters(), 3e-3)
    values = []
    for _ in range(12):
        loss = torch.stack(list(problem.losses(network, batch).values())).sum()
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


def test_a_run_learns_from_rooms_drawn_once(
    folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[int] = []

    def generated(split: Split, index: int, views: int, size: int, library: None) -> object:
        made.append(index)
        return box_room(index, views=views)

    monkeypatch.setattr(rooms, "generated", generated)
    config = TrainConfig(
        "aligner",
        AlignerProblem(size=ALIGNER, weights=folder),
        steps=4,
        rooms=1,
        views=2,
        made_views=3,
        pool=2,
        validation_rooms=1,
        store=str(tmp_path / "store"),
    )
    loop.train(config, tmp_path / "run", device="cpu", jobs=0)
    assert sorted(made) == [0, 0, 1]
    kept = sorted(path.name for path in (tmp_path / "store").iterdir())
    assert len(kept) == 2 and kept[1].startswith(f"{kept[0]}-")
    assert weights.load("aligner", tmp_path / "run")[1]["steps"] == 4


def test_the_verifier_learns_from_the_aligners_candidates(folder: str) -> None:
    problem = VerifierProblem(
        size=VerifierNetworkConfig(width=16), weights=folder, pairs=6, candidates=4
    )
    batch = batch_of(problem)
    assert batch["motion"].shape == (12, 4, 3)
    assert (batch["score"].diff(dim=1) <= 1e-6).all()
    turn = batch["motion"][..., 0] - batch["yaw"][:, None]
    assert (turn.cos()[batch["right"]] > 0.9).all()
