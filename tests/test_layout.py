"""The layout network: where points go, what it learns, and what it does with nothing."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from fewview.completion.layout.complete import complete_layout
from fewview.completion.layout.grid import (
    CELL_M,
    CELLS,
    CLASSES,
    cell_centres,
    cells_of,
    field_of_view,
)
from fewview.completion.layout.network import LayoutNetwork, LayoutNetworkConfig
from fewview.completion.layout.pointnet import PointBatch, SplitLinear
from fewview.completion.layout.points import ScanPoints, about_vertical, scan_points
from fewview.completion.layout.pooling import BINS, heights_over, pooled, seen_through
from fewview.geometry import se3
from fewview.training.cell_matches import match_loss, match_recall
from fewview.training.layout import LayoutProblem, calibration_error, figures, turned_layout
from fewview.types import RingScan
from tests.box_rooms import box_room

SIZE = LayoutNetworkConfig(width=8, point_features=4)
PROBLEM = LayoutProblem(size=SIZE, points=256, matches=32, tilt_deg=0.0)
EMPTY = RingScan(np.zeros((16, 64, 3), np.uint8), np.zeros((16, 64), np.float32), np.eye(4))


def scan_of(seed: int, count: int = 256) -> ScanPoints:
    room = box_room(seed, views=1)
    ring = RingScan(room.colour[0], room.measured[0], np.eye(4))
    return scan_points(ring, np.random.default_rng(0), count)


@pytest.fixture
def network() -> LayoutNetwork:
    torch.manual_seed(0)
    return PROBLEM.network().eval()


def test_ahead_is_at_the_top_and_left_on_the_left() -> None:
    cell, inside = cells_of(torch.tensor([[3.9, 0.01, 0.0], [0.01, 3.9, 0.0], [4.1, 0.0, 0.0]]))
    assert cell.tolist() == [31, 31 * CELLS, 0]
    assert inside.tolist() == [True, True, False]


def test_a_centre_lies_in_its_own_cell() -> None:
    cell, inside = cells_of(torch.from_numpy(cell_centres().reshape(-1, 2)))
    assert inside.all()
    assert torch.equal(cell, torch.arange(CELLS * CELLS))


def test_the_field_of_view_is_the_wedge_that_was_looked_into() -> None:
    seen = field_of_view(np.radians(np.arange(-30.0, 30.5, 0.5)).astype(np.float32))
    assert seen[0, 32] and seen[20, 31]
    assert not seen[-1, 32] and not seen[32, 0] and not seen[32, -1]
    assert seen.mean() == pytest.approx(0.16, abs=0.03)


def test_points_of_a_scan_lie_on_what_it_measured() -> None:
    room = box_room(3, views=1)
    scan = scan_of(3)
    assert scan.valid.all()
    points = scan.points @ scan.wall_R_level
    normals, offsets = room.planes[0, :6, :3], room.planes[0, :6, 3]
    assert np.abs(points @ normals.T - offsets).min(axis=1).max() < 1e-4
    assert (points[:, 0] > 0).all()


@pytest.mark.parametrize("seed", range(4))
def test_the_wall_frame_lies_along_the_walls(seed: int) -> None:
    room = box_room(seed, views=1)
    wall = scan_of(seed).wall_R_level @ room.planes[0, 2, :3]
    assert np.abs(wall[:2]).max() == pytest.approx(1.0, abs=1e-3)
    assert abs(float(scan_of(seed).heading)) <= np.pi / 4 + 1e-6


def test_a_ring_turned_otherwise_gives_the_same_heading() -> None:
    room = box_room(1, views=1, size=32)
    level_T_scan = se3.pose(room.scan_R_level[0].T, np.zeros(3))
    turned = se3.pose(about_vertical(np.array(np.pi / 2)).astype(np.float64), np.zeros(3))
    measured, colour = room.measured[0], room.colour[0]
    ahead = RingScan(colour, measured, level_T_scan)
    aside = RingScan(
        np.roll(colour, -32, axis=1), np.roll(measured, -32, axis=1), turned @ level_T_scan
    )
    first, second = (scan_points(r, np.random.default_rng(0), 1024) for r in (ahead, aside))
    assert float(second.heading) == pytest.approx(float(first.heading), abs=1e-3)
    assert np.abs(first.points.mean(axis=0) - second.points.mean(axis=0)).max() < 1e-3
    back = about_vertical(np.array(-np.pi / 2))
    np.testing.assert_allclose(second.wall_R_level, first.wall_R_level @ back, atol=1e-3)


def test_a_layout_turned_there_and_back_is_the_same_inside() -> None:
    layout = torch.from_numpy(box_room(1, views=1).layout.astype(np.int64))
    turn = about_vertical(np.array([0.4]))
    there, known = turned_layout(layout, turn)
    back, _ = turned_layout(there, turn.swapaxes(1, 2))
    inside = torch.from_numpy(np.hypot(*cell_centres().transpose(2, 0, 1)) < 3.8)
    assert (back == layout)[0, inside].float().mean() > 0.93
    assert known[0, inside].all() and not known.all()
    ahead = torch.zeros(1, CELLS, CELLS, dtype=torch.int64)
    ahead[0, 8, 32] = 1
    moved = turned_layout(ahead, about_vertical(np.array([0.5 * np.pi])))[0].nonzero()
    assert moved.tolist() == [[0, 31, 8]]


def test_pooling_means_and_maxima_by_bin() -> None:
    points = torch.tensor([[[1.03, 1.03, 0.0], [1.05, 1.05, 0.1], [1.04, 1.04, 1.0], [9, 0, 0]]])
    features = torch.tensor([[[1.0], [3.0], [7.0], [50.0]]])
    heights = heights_over(torch.tensor([[0.0, 0.0, 0.0]]), points)
    grid = pooled(features, points, heights, torch.ones(1, 4, dtype=torch.bool))
    bins = grid.reshape(BINS, 3, CELLS * CELLS)
    cell = int(cells_of(points[0])[0][0])
    assert bins[1, :2, cell].tolist() == [2.0, 3.0]
    assert bins[2, :2, cell].tolist() == [7.0, 7.0]
    assert float(bins[1, 2, cell]) == pytest.approx(np.log(3) / np.log(9))
    assert int((grid != 0).sum()) == 6


def test_heights_are_over_the_sloping_floor() -> None:
    heights = heights_over(torch.tensor([[-1.0, 0.5, 0.0]]), torch.tensor([[[1.0, 0.0, 0.0]]]))
    assert float(heights[0, 0]) == pytest.approx(0.5)


def test_free_space_ends_before_the_wall() -> None:
    points = torch.tensor([[[3.0, 0.01, 0.0], [9.0, 0.0, 0.0]]])
    free = seen_through(points, torch.tensor([[-1.2, 0.0, 0.0]]), torch.tensor([[True, False]]))
    rows = free[0, 2, :, 31].nonzero().flatten()
    assert int(rows.max()) == 31
    assert (4.0 - CELL_M * int(rows.min())) == pytest.approx(2.8, abs=0.2)
    assert int((free > 0).sum()) == len(rows)


def test_the_split_layer_equals_the_layer_over_both() -> None:
    layer = SplitLinear(3, 5, 4)
    local, whole = torch.randn(2, 7, 3), torch.randn(2, 5)
    weight = torch.cat([layer.local.weight, layer.whole.weight], dim=1)
    both = torch.cat([local, whole[:, None].expand(-1, 7, -1)], dim=-1)
    torch.testing.assert_close(layer(local, whole), both @ weight.T + layer.local.bias)


def test_shapes_and_unit_descriptors(network: LayoutNetwork) -> None:
    result = complete_layout(EMPTY, scan_of(1), network)
    assert result.probabilities.shape == (5, CELLS, CELLS)
    np.testing.assert_allclose(result.probabilities.sum(axis=0), 1.0, atol=1e-5)
    assert result.descriptors.shape == (CELLS, CELLS, 32)
    np.testing.assert_allclose(np.linalg.norm(result.descriptors, axis=-1), 1.0, atol=1e-4)
    chosen = np.take_along_axis(result.probabilities, result.classes[None].astype(int), axis=0)
    np.testing.assert_allclose(result.confidence, chosen[0])
    assert 0.02 < result.observed.mean() < 0.3
    assert np.linalg.norm(result.floor[:3]) == pytest.approx(1.0)


def test_the_order_of_points_does_not_matter(network: LayoutNetwork) -> None:
    batch = PointBatch.of([scan_of(2)])
    order = torch.randperm(batch.points.shape[1], generator=torch.Generator().manual_seed(1))
    shuffled = batch._replace(
        **{
            n: getattr(batch, n)[:, order]
            for n in ("points", "colours", "normals", "valid", "pixels")
        }
    )
    torch.testing.assert_close(network(shuffled).logits, network(batch).logits, atol=1e-4, rtol=0)


def test_an_empty_scan_gets_an_answer(network: LayoutNetwork) -> None:
    result = complete_layout(EMPTY, scan_points(EMPTY, np.random.default_rng(0), 64), network)
    assert np.isfinite(result.probabilities).all()
    assert not result.observed.any()


def test_probabilities_undo_the_weights_of_the_classes(network: LayoutNetwork) -> None:
    truth = torch.tensor([0.4, 0.1, 0.3, 0.15, 0.05])
    logits = torch.log(truth * network.class_weights)[None, :, None, None]
    torch.testing.assert_close(network.probabilities(logits)[0, :, 0, 0], truth)


def test_a_wall_that_may_be_elsewhere_is_still_a_wall(network: LayoutNetwork) -> None:
    truth = torch.tensor([0.35, 0.25, 0.3, 0.05, 0.05])
    logits = torch.log(truth * network.class_weights)[None, :, None, None]
    assert CLASSES[int(network.classes(logits))] == "wall"


def batch_of(rooms: int = 2, views: int = 2) -> dict[str, Tensor]:
    samples = [box_room(i, views=views) for i in range(rooms)]
    return PROBLEM.batch(samples, np.random.default_rng(0))


def test_the_losses_fall() -> None:
    torch.manual_seed(0)
    network, batch = PROBLEM.network(), batch_of()
    optimiser = torch.optim.Adam(network.parameters(), 1e-2)
    totals: list[dict[str, float]] = []
    for _ in range(40):
        losses = PROBLEM.losses(network, batch)
        optimiser.zero_grad()
        sum(losses.values()).backward()  # type: ignore[union-attr]
        optimiser.step()
        totals.append({k: float(v.detach()) for k, v in losses.items()})
    assert totals[-1]["layout"] < 0.75 * totals[0]["layout"]
    assert totals[-1]["descriptor"] < 0.9 * totals[0]["descriptor"]
    with torch.no_grad():
        metrics = PROBLEM.metrics(network, batch)
    assert metrics["accuracy"] > 0.6
    assert all(np.isfinite(v) for v in metrics.values())


def test_the_same_seed_gives_the_same_batch() -> None:
    first, second = batch_of(), batch_of()
    assert first.keys() == second.keys()
    assert all(torch.equal(first[k], second[k]) for k in first)


def test_matched_cells_show_the_same_place() -> None:
    batch = batch_of()
    here = batch["layout"].flatten(1)[batch["match_source"][:, None], batch["match_cell"]]
    cells, inside = cells_of(batch["match_place"])
    there = batch["layout"].flatten(1)[batch["match_target"][:, None], cells]
    valid = batch["match_valid"]
    assert valid.sum() > 50 and inside[valid].all()
    assert (here == there)[valid].float().mean() > 0.5


def test_descriptors_that_tell_places_apart_have_no_loss_and_full_recall() -> None:
    batch = batch_of()
    world = torch.linalg.inv(torch.from_numpy(_poses(batch)).float())
    centres = torch.from_numpy(cell_centres()).reshape(-1, 2)
    places = centres @ world[:, :2, :2].mT + world[:, None, :2, 3]
    frequency = torch.arange(1, 9) * 0.9
    waves = (places[..., None] * frequency).flatten(2)
    described = torch.cat([waves.sin(), waves.cos()], dim=-1)
    described = torch.nn.functional.normalize(described, dim=-1).mT.reshape(-1, 32, CELLS, CELLS)
    assert float(match_loss(described, batch)) < 0.5
    recall = match_recall(described, torch.zeros(4, CELLS, CELLS, dtype=torch.bool), batch)
    assert recall["match_pp_1"] > 0.95 > 0.5 > recall["match_chance_1"]
    flat = torch.ones_like(described) / 32**0.5
    assert float(match_loss(flat, batch)) > 2.0


def _poses(batch: dict[str, Tensor]) -> np.ndarray:
    poses = np.concatenate([box_room(i, views=2).level_T_world for i in range(2)])
    turns = about_vertical(batch["heading"].double().numpy()).astype(np.float64)
    return np.asarray(se3.pose(turns, np.zeros((4, 3))) @ poses)


def test_figures_of_a_perfect_and_an_empty_answer() -> None:
    truth = torch.from_numpy(box_room(5, views=1).layout.astype(np.int64))
    hidden = torch.ones_like(truth, dtype=torch.bool)
    assert set(figures(truth, truth, hidden).values()) == {1.0}
    nothing = figures(torch.zeros_like(truth), truth, hidden)
    assert nothing["wall_recall"] == nothing["free_iou"] == 0.0
    shifted = figures(truth.roll(1, dims=1), truth, hidden)
    assert shifted["wall_recall"] > 0.95 > shifted["wall_iou"]


def test_calibration_error_of_overconfidence() -> None:
    chance = torch.tensor([0.9, 0.1, 0, 0, 0]).reshape(1, 5, 1, 1).expand(1, 5, 10, 10)
    truth = torch.ones(1, 10, 10, dtype=torch.long)
    truth.view(-1)[:50] = 0
    assert calibration_error(chance, truth, truth >= 0) == pytest.approx(0.4, abs=1e-5)
