"""The training loop, on rooms that are quick to make."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from box_rooms import box_room
from torch import Tensor

from fewview import cli, config, weights
from fewview.completion.panorama.network import PanoramaNetworkConfig
from fewview.completion.panorama.ring import ring_normals, ring_points
from fewview.errors import ConfigError, FewviewError
from fewview.geometry import se3
from fewview.synthetic.samples import RoomSample
from fewview.training import contrastive, loop, losses, settings
from fewview.training.panorama import PanoramaProblem
from fewview.training.rooms import RoomBatches, Stored, loader, mirrored
from fewview.training.settings import TrainConfig

ROOT = Path(__file__).parent.parent
TINY = PanoramaProblem(PanoramaNetworkConfig(width=16, descriptor=8), pairs=32)
SHORT = TrainConfig(
    "panorama",
    TINY,
    steps=4,
    rooms=1,
    views=2,
    warmup_steps=2,
    validation_rooms=2,
    validate_every=2,
    log_every=1,
)


def box_rooms(split: str, index: int, views: int, size: int) -> RoomSample:
    return box_room(index + 1000 * (split != "train"), views, size)


def trained(config: TrainConfig, out: Path, resume: bool = False) -> dict[str, Tensor]:
    """The weights that a run ends with."""
    loop.train(config, out, resume=resume, device="cpu", jobs=0, source=box_rooms)
    stored = torch.load(out / loop.CHECKPOINT, weights_only=True)
    assert stored["state"]["step"] == config.steps
    return dict(stored["network"])


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("run")
    trained(SHORT, out)
    return out


class Stop(Exception):
    pass


def test_a_resumed_run_ends_with_the_same_weights(finished: Path, tmp_path: Path) -> None:
    def stops(line: str) -> None:
        if line.startswith("step 3"):
            raise Stop

    with pytest.raises(Stop):
        loop.train(SHORT, tmp_path, device="cpu", jobs=0, source=box_rooms, report=stops)
    assert torch.load(tmp_path / loop.CHECKPOINT, weights_only=True)["state"]["step"] == 3
    resumed = trained(SHORT, tmp_path, resume=True)
    whole = torch.load(finished / loop.CHECKPOINT, weights_only=True)["network"]
    assert all(torch.equal(whole[name], resumed[name]) for name in whole)
    curves = json.loads((tmp_path / loop.CURVES).read_text())
    expected = json.loads((finished / loop.CURVES).read_text())
    assert curves["validation"] == expected["validation"]


def test_a_run_leaves_weights_card_curves_and_settings(finished: Path) -> None:
    state, card = weights.load("panorama", finished)
    TINY.network().load_state_dict(state)
    assert card["name"] == "panorama" and card["seed"] == 0
    assert 0 < card["steps"] <= SHORT.steps
    assert card["config"]["settings"]["size"] == dataclasses.asdict(TINY.size)
    curves = json.loads((finished / loop.CURVES).read_text())
    assert [p["step"] for p in curves["training"]] == [1, 2, 3, 4]
    assert [p["step"] for p in curves["validation"]] == [2, 4]
    best = min(curves["validation"], key=lambda p: p["loss"])
    assert card["steps"] == best["step"]
    assert card["validation"]["loss"] == pytest.approx(best["loss"], abs=1e-5)
    again = settings.load(finished / loop.SETTINGS)
    assert again == SHORT


def test_a_run_begins_with_the_weights_of_another(finished: Path, tmp_path: Path) -> None:
    config = dataclasses.replace(
        SHORT, init=str(finished), store=str(tmp_path / "rooms"), learning_rate=0.0, steps=2
    )
    weights_after = trained(config, tmp_path / "out")
    begun, first = weights.load("panorama", finished)
    assert all(torch.equal(begun[name], weights_after[name]) for name in begun)
    _, card = weights.load("panorama", tmp_path / "out")
    assert card["config"]["init"] == finished.name
    assert card["config"]["store"] == "rooms"
    assert card["began_with"]["sha256"] == first["sha256"]
    assert card["began_with"]["steps"] == first["steps"]


def test_the_loss_falls() -> None:
    torch.manual_seed(0)
    network = TINY.network()
    batch = TINY.batch([box_room(0, 2, 64)], np.random.default_rng(0))
    optimiser = torch.optim.AdamW(network.parameters(), 3e-3)
    totals = []
    for _ in range(12):
        parts = TINY.losses(network, batch)
        optimiser.zero_grad()
        torch.stack(list(parts.values())).sum().backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        totals.append({name: value.item() for name, value in parts.items()})
    assert set(totals[0]) == {
        "depth_likelihood",
        "depth_l1",
        "depth_relative",
        "normal",
        "semantics",
        "descriptor",
    }
    assert all(totals[-1][name] < totals[0][name] for name in totals[0])


def test_a_run_is_not_overwritten(finished: Path) -> None:
    with pytest.raises(FewviewError, match="--resume"):
        loop.train(SHORT, finished, source=box_rooms)


def test_nothing_to_resume_is_said(tmp_path: Path) -> None:
    with pytest.raises(FewviewError, match="leave out --resume"):
        loop.train(SHORT, tmp_path, resume=True, jobs=0, source=box_rooms)


def test_resuming_with_other_settings_is_refused(finished: Path) -> None:
    other = dataclasses.replace(SHORT, learning_rate=0.5)
    with pytest.raises(FewviewError, match="learning_rate"):
        loop.train(other, finished, resume=True, jobs=0, source=box_rooms)


def test_a_gpu_that_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert loop.chosen_device("auto").type == "cpu"
    with pytest.raises(FewviewError, match="no GPU"):
        loop.chosen_device("cuda")


def test_workers_make_the_same_batches_in_the_same_order() -> None:
    batches = RoomBatches(SHORT, box_rooms)
    alone = list(loader(batches, range(2, 6), 0))
    together = list(loader(batches, range(2, 6), 2))
    for a, b in zip(alone, together, strict=True):
        assert all(torch.equal(a[name], b[name]) for name in a)
    assert not torch.equal(alone[0]["depth"], alone[1]["depth"])


def test_a_pool_comes_round() -> None:
    batches = RoomBatches(dataclasses.replace(SHORT, pool=3), box_rooms)
    assert torch.equal(batches[0]["depth"], batches[6]["depth"])
    assert not torch.equal(batches[0]["depth"], batches[1]["depth"])
    assert not torch.equal(batches[0]["depth"], batches[3]["depth"])
    assert not torch.equal(batches[0]["source"], batches[6]["source"])


def test_a_batch_draws_some_of_the_cameras() -> None:
    config = dataclasses.replace(SHORT, made_views=6, views=3, pool=1)
    every = np.linalg.norm(box_room(0, 6, 64).level_T_world[:, :3, 3], axis=1)
    drawn = [RoomBatches(config, box_rooms)[step] for step in (0, 2)]
    for batch in drawn:
        found = batch["world_T_level"][:, :3, 3].norm(dim=1).numpy()
        assert len(found) == len(np.unique(found)) == 3
        assert np.abs(found[:, None] - every).min(axis=1).max() < 1e-5
    assert not torch.equal(drawn[0]["depth"], drawn[1]["depth"])


def test_a_mirrored_room_is_a_room() -> None:
    room = box_room(3, 3, 64)
    other = mirrored(room)
    again = mirrored(other)
    for name, array in vars(room).items():
        np.testing.assert_allclose(getattr(again, name), array, atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(other.level_T_world), 1.0)
    np.testing.assert_allclose(np.linalg.det(other.scan_R_level), 1.0)
    own, flipped = (
        se3.transform(se3.inverse(r.level_T_world), ring_points(r.depth).reshape(3, -1, 3))
        for r in (room, other)
    )
    for a, b in zip(own, flipped, strict=True):
        np.testing.assert_allclose(np.sort(a[:, 1]), np.sort(-b[:, 1]), atol=1e-5)
    found = ring_normals(torch.from_numpy(other.depth)).permute(0, 2, 3, 1).numpy()
    assert np.mean((found * other.normal).sum(axis=-1) > 0.99) > 0.95
    ahead = other.planes[0, other.plane_kind[0] == 3]
    points = ring_points(other.depth)[0].reshape(-1, 3)
    behind = points @ ahead[:, :3].T - ahead[:, 3]
    assert behind.min() > -1e-4


def test_rooms_are_made_once_and_read_the_same(tmp_path: Path) -> None:
    made = []

    def source(split: str, index: int, views: int, size: int) -> RoomSample:
        made.append(index)
        return box_rooms(split, index, views, size)

    stored = Stored(tmp_path, source)
    first, second = stored("train", 7, 2, 64), stored("train", 7, 2, 64)
    assert made == [7]
    for name, array in vars(box_room(7, 2, 64)).items():
        again = getattr(second, name)
        np.testing.assert_array_equal(getattr(first, name), again)
        assert again.dtype == array.dtype
        np.testing.assert_allclose(again, array, rtol=1e-3)


def test_learning_rate_rises_and_falls() -> None:
    config = dataclasses.replace(SHORT, steps=100, warmup_steps=10, learning_rate=1.0)
    rates = [loop.learning_rate(step, config) for step in range(101)]
    assert rates[9] == 1.0 and rates[100] == pytest.approx(0.01)
    assert np.all(np.diff(rates[:10]) > 0) and np.all(np.diff(rates[10:]) < 0)


def test_pairs_show_the_same_places() -> None:
    rooms = [box_room(seed, 3, 64) for seed in (0, 1)]
    found = contrastive.sample_pairs(rooms, 64, np.random.default_rng(0))
    assert found["rings"].shape == (6, 2) and found["source"].shape == (6, 64)
    depth = np.concatenate([room.depth for room in rooms])
    poses = se3.inverse(np.concatenate([room.level_T_world for room in rooms]))
    world = se3.transform(poses, ring_points(depth).reshape(6, -1, 3).astype(float))
    seen = np.concatenate([room.measured for room in rooms]).reshape(6, -1) > 0
    for p, (a, b) in enumerate(found["rings"].tolist()):
        source, target = found["source"][p].numpy(), found["target"][p].numpy()
        assert found["valid"][p].all()
        gap = np.linalg.norm(world[a, source] - world[b, target], axis=1)
        assert gap.max() < contrastive.POSITIVE_M
        kind = 2 - seen[a, source].astype(int) - seen[b, target]
        np.testing.assert_array_equal(found["kind"][p], kind)
    assert len(np.unique(found["kind"])) == 3


def test_the_true_places_as_descriptors_are_always_found() -> None:
    batch = TINY.batch([box_room(0, 3, 64)], np.random.default_rng(0))
    every = torch.arange(64 * 256).expand(3, -1)
    points = contrastive.places(batch, torch.arange(3), every).reshape(3, 64, 256, 3)
    places = points[:, ::2, ::2].permute(0, 3, 1, 2)
    lifted = torch.cat([places, places.square().sum(dim=1, keepdim=True), places[:, :1] * 0 + 1], 1)
    found = contrastive.recall(lifted_for_distance(lifted), batch)
    for kind in contrastive.KINDS:
        assert found[f"recall_1_{kind}"] > 0.7
        assert found[f"chance_1_{kind}"] < 0.05
    blind = contrastive.recall(torch.ones_like(lifted), batch)
    assert blind["recall_1_predicted_predicted"] < 0.2


def lifted_for_distance(lifted: Tensor) -> Tensor:
    """Unit vectors whose cosine falls with the distance of the points: random Fourier features."""
    generator = torch.Generator().manual_seed(0)
    waves = 4.0 * torch.randn(512, 3, generator=generator)
    phase = torch.einsum("kc,bchw->bkhw", waves, lifted[:, :3])
    return torch.cat([phase.cos(), phase.sin()], dim=1) / 512**0.5


def test_info_nce_prefers_the_right_partner() -> None:
    torch.manual_seed(0)
    source = torch.nn.functional.normalize(torch.randn(1, 20, 16), dim=2)
    far, valid = 10.0 * torch.randn(1, 20, 3), torch.ones(1, 20, dtype=torch.bool)
    right = losses.info_nce(source, source, far, valid)
    wrong = losses.info_nce(source, source.flip(1), far, valid)
    assert right < 0.1 < 5.0 < wrong
    together = losses.info_nce(source, source.flip(1), torch.zeros(1, 20, 3), valid)
    assert together < 1e-3
    assert losses.info_nce(source, source, far, ~valid) == 0.0


def test_info_nce_is_hardest_at_one_height() -> None:
    """Descriptors that tell only the height find their partner only where heights differ."""
    torch.manual_seed(0)
    angle = torch.linspace(0.0, 3.0, 20)
    by_height = torch.stack([angle.cos(), angle.sin()], dim=1)[None]
    places = torch.cat([10.0 * torch.randn(1, 20, 2), angle[None, :, None]], dim=2)
    valid = torch.ones(1, 20, dtype=torch.bool)
    apart = losses.info_nce(by_height, by_height, 3.0 * places, valid)
    alike = by_height[:, :1].expand_as(by_height)
    level = torch.cat([10.0 * torch.randn(1, 20, 2), torch.zeros(1, 20, 1)], dim=2)
    together = losses.info_nce(alike, alike, level, valid)
    assert together == pytest.approx(np.log(20), abs=0.1)
    assert apart < together - 0.5


def test_laplace_wants_the_scale_to_be_the_error() -> None:
    error = torch.tensor(0.2)
    values = [float(losses.laplace(error, torch.tensor(np.log(s)))) for s in (0.1, 0.2, 0.4)]
    assert values[1] == min(values)


def test_the_shipped_settings_are_read() -> None:
    found = settings.load(ROOT / "configs" / "train_panorama.yaml", ("settings.size.width=24",))
    assert found.problem == "panorama"
    assert isinstance(found.settings, PanoramaProblem)
    assert found.settings.size.width == 24


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"steps": 3}, "problem: NAME"),
        ({"problem": "sudoku"}, "unknown problem 'sudoku'"),
        ({"problem": "panorama", "step": 3}, "did you mean 'steps'"),
        ({"problem": "panorama", "settings": {"sise": 3}}, "did you mean 'settings.size'"),
        ({"problem": "panorama", "rooms": 0}, "at least 1"),
        ({"problem": "panorama", "made_views": 2}, "made_views"),
    ],
)
def test_wrong_settings_are_refused(tmp_path: Path, values: dict[str, Any], message: str) -> None:
    file = tmp_path / "train.yaml"
    file.write_text(yaml.safe_dump(values))
    with pytest.raises(ConfigError, match=message):
        settings.load(file)


def test_training_settings_are_no_preset() -> None:
    with pytest.raises(ConfigError, match="choose one of accurate, default, fast$"):
        config.load("train_panorama")


def test_the_command_names_what_it_cannot_do(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["train", str(tmp_path / "none.yaml")]) == cli.BAD_INPUT
    assert "not a readable YAML file" in capsys.readouterr().err


def test_training_needs_neither_opencv_nor_open3d() -> None:
    code = (
        "import sys; import fewview.training.loop, fewview.training.panorama; "
        "print({'cv2', 'open3d', 'gtsam', 'rerun'} & set(sys.modules))"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True
    )
    assert done.stdout.strip() == "set()"
