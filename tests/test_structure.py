"""The structure network: votes for walls, slots, what it learns, and planes of one scan."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from fewview.completion.layout.pointnet import PointBatch
from fewview.completion.layout.points import ScanPoints, scan_points
from fewview.completion.structure import anchors
from fewview.completion.structure.complete import complete_planes, snapped
from fewview.completion.structure.network import (
    LevelPrediction,
    StructureNetwork,
    StructureNetworkConfig,
    WallPrediction,
)
from fewview.training.plane_figures import box_walls, plane_figures
from fewview.training.plane_matches import seen_planes
from fewview.training.point_batches import given
from fewview.training.problem import Batch
from fewview.training.structure import StructureProblem
from fewview.training.structure_targets import plane_truth, wall_slots
from fewview.types import RingScan
from tests.box_rooms import EYE_M, HEIGHT_M, box_room

SIZE = StructureNetworkConfig(local=16, whole=32, sector=32)
PROBLEM = StructureProblem(size=SIZE, points=256, matches=32, tilt_deg=0.0)
SLOTS = anchors.ANCHORS * anchors.SLOTS


def scan_of(seed: int, count: int = 256) -> ScanPoints:
    room = box_room(seed, views=1)
    ring = RingScan(room.colour[0], room.measured[0], np.eye(4))
    return scan_points(ring, np.random.default_rng(0), count)


def batch_of(rooms: int = 2) -> Batch:
    samples = [box_room(i) for i in range(rooms)]
    return PROBLEM.batch(samples, np.random.default_rng(0))


@pytest.fixture
def network() -> StructureNetwork:
    torch.manual_seed(0)
    return PROBLEM.network().eval()


def test_a_wall_gets_the_votes_of_its_points() -> None:
    y = torch.linspace(-1, 1, 50)
    points = torch.stack([torch.full_like(y, 3.1), y, 0 * y], dim=-1)[None]
    normals = torch.tensor([-1.0, 0.0, 0.0]).expand(1, 50, 3)
    votes = anchors.wall_votes(points, normals, torch.ones(1, 50, dtype=torch.bool))
    direction, distance = divmod(int(votes.flatten().argmax()), anchors.BINS)
    assert direction == 0
    centre = anchors.NEAREST_M + anchors.BIN_M * (distance + 0.5)
    assert centre == pytest.approx(3.1, abs=anchors.BIN_M)
    assert float(votes.exp().sub(1).sum()) * anchors.FULL_COUNT == pytest.approx(50, rel=1e-3)
    assert not anchors.wall_votes(points, normals, torch.zeros(1, 50, dtype=torch.bool)).any()


def test_how_far_points_reach() -> None:
    points = torch.tensor([[[2.0, 0.0, 0.0], [0.0, -3.0, 1.0], [9.0, 9.0, 0.0]]])
    far = anchors.reach(points, torch.tensor([[True, True, False]]))[0]
    quarter = anchors.DIRECTIONS // 4
    torch.testing.assert_close(
        far[::quarter], torch.tensor([2.0, 0.0, 0.0, 3.0]), atol=1e-5, rtol=0
    )


def test_of_two_walls_on_one_plane_the_more_probable_stays() -> None:
    azimuth = torch.tensor([[0.0, 0.1, 3.1, 0.0]])
    distance = torch.tensor([[2.0, 2.2, 2.0, 4.0]])
    kept = anchors.distinct(azimuth, distance, torch.tensor([[0.6, 0.9, 0.5, 0.4]]))
    assert kept.tolist() == [[False, True, True, True]]


def test_slots_give_the_walls_back() -> None:
    room = box_room(4, views=3)
    slots = wall_slots(plane_truth(room))
    for v in range(3):
        filled = np.flatnonzero(slots.plane[v] >= 0)
        assert sorted(slots.plane[v, filled]) == [2, 3, 4, 5]
        azimuth, distance = (torch.from_numpy(a[v]) for a in (slots.azimuth, slots.distance))
        planes = anchors.wall_planes(azimuth, distance).numpy()
        np.testing.assert_allclose(
            planes[filled], room.planes[v, slots.plane[v, filled]], atol=1e-5
        )
        off = azimuth - anchors.anchor_azimuths(azimuth)
        off = torch.atan2(off.sin(), off.cos()).abs()[filled]
        assert float(off.max()) <= 0.5 * anchors.SECTOR + 1e-5


def test_the_centre_of_a_plane_is_one_place_for_all_cameras() -> None:
    room = box_room(2, views=3, size=32)
    truth = plane_truth(room)
    back = np.linalg.inv(room.level_T_world)
    world = np.einsum("vij,vpj->vpi", back[:, :3, :3], truth.centre) + back[:, None, :3, 3]
    np.testing.assert_allclose(world, world[:1].repeat(3, axis=0), atol=1e-4)
    walls = world[0, 2:6]
    np.testing.assert_allclose(walls[:, 2], 0.5 * HEIGHT_M, atol=1e-4)
    np.testing.assert_allclose(np.abs(walls[:, :2]).min(axis=1), 0.0, atol=0.15)
    assert truth.known[0, 2:6].all()


def test_points_know_their_planes() -> None:
    batch = batch_of()
    label = batch["point_plane"]
    assert (label >= 0).float().mean() > 0.7
    plane = batch["plane"].gather(1, label.clamp(min=0)[..., None].expand(-1, -1, 4))
    gap = ((plane[..., :3] * batch["points"]).sum(dim=-1) - plane[..., 3]).abs()
    assert float(gap[label >= 0].max()) < 1e-3
    cosine = (plane[..., :3] * batch["point_normal"]).sum(dim=-1)
    assert float(cosine[label >= 0].min()) > 0.99
    assert seen_planes(batch).any(dim=1).all()


def test_the_order_of_points_does_not_matter(network: StructureNetwork) -> None:
    batch = PointBatch.of([scan_of(2)])
    order = torch.randperm(batch.points.shape[1], generator=torch.Generator().manual_seed(1))
    shuffled = batch._replace(
        **{
            n: getattr(batch, n)[:, order]
            for n in ("points", "colours", "normals", "valid", "pixels")
        }
    )
    points, walls, levels = network(batch)
    other_points, other_walls, other_levels = network(shuffled)
    torch.testing.assert_close(other_walls, walls, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(other_levels, levels, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(other_points.offset, points.offset[:, order], atol=1e-4, rtol=1e-4)


def test_the_losses_fall() -> None:
    torch.manual_seed(0)
    network, batch = PROBLEM.network(), batch_of()
    optimiser = torch.optim.Adam(network.parameters(), 2e-3)
    totals: list[dict[str, float]] = []
    for _ in range(60):
        losses = PROBLEM.losses(network, batch)
        optimiser.zero_grad()
        sum(losses.values()).backward()  # type: ignore[union-attr]
        optimiser.step()
        totals.append({k: float(v.detach()) for k, v in losses.items()})
    for name in ("normal", "semantics", "exists", "azimuth", "distance", "descriptor"):
        assert totals[-1][name] < 0.7 * totals[0][name], name
    with torch.no_grad():
        figures = PROBLEM.metrics(network, batch)
    assert figures["distance_m_seen"] < 1.0
    assert figures.keys() > {"recall_unseen", "box_recall_unseen", "wall_match_1_pp"}


def test_true_walls_have_full_precision_and_recall() -> None:
    batch = batch_of()
    exists = torch.where(batch["wall_plane"] >= 0, 5.0, -5.0)
    zero = torch.zeros_like(exists)
    size = (*exists.shape, 32)
    walls = WallPrediction(
        exists, batch["wall_azimuth"], batch["wall_distance"], zero, zero, zero, torch.zeros(size)
    )
    height = torch.tensor([-EYE_M, HEIGHT_M - EYE_M]).expand(len(exists), 2)
    levels = LevelPrediction(height, torch.zeros(len(exists), 2), torch.zeros(len(exists), 2, 32))
    figures = plane_figures(walls, levels, batch)
    for name in ("recall_seen", "recall_unseen_strict", "precision_strict"):
        assert figures[name] == 1.0
    assert figures["floor_m"] == pytest.approx(0.0, abs=1e-5)
    assert figures["ceiling_m"] == pytest.approx(0.0, abs=1e-5)
    nowhere = plane_figures(walls._replace(exists=zero - 5.0), levels, batch)
    assert nowhere["recall_seen"] == 0.0


def test_the_box_finds_the_walls_that_are_seen() -> None:
    batch = batch_of()
    azimuth, distance, kept = box_walls(batch)
    assert kept.all() and (distance >= 0).all()
    true = torch.atan2(-batch["plane"][..., 1], -batch["plane"][..., 0])[:, 2:6]
    off = torch.atan2((azimuth[:, :1] - true).sin(), (azimuth[:, :1] - true).cos()).abs()
    assert float(off.amin(dim=1).max()) < 1e-4


def test_a_plane_snaps_to_its_points() -> None:
    scan = scan_of(1)
    upright = np.abs(scan.normals[:, 0]) > 0.9
    side = np.sign(np.median(scan.normals[upright, 0]))
    wall = upright & (scan.normals[:, 0] * side > 0.9)
    true = float(np.median(scan.points[wall, 0])) * side
    start = np.array([side * math.cos(0.1), math.sin(0.1), 0.0, true + 0.1])
    plane, observed = snapped(start, scan, upright=True)
    assert observed
    np.testing.assert_allclose(plane, [side, 0.0, 0.0, true], atol=1e-2)
    far, observed = snapped(start + [0, 0, 0, 3.0], scan, upright=True)
    assert not observed and far[3] == start[3] + 3.0


def test_planes_of_one_scan(network: StructureNetwork) -> None:
    with torch.no_grad():
        network.wall_head.bias.zero_()
    result = complete_planes(scan_of(3), network)
    assert [p.kind for p in result.planes[:3]] == ["floor", "ceiling", "wall"]
    assert result.planes[0].observed
    np.testing.assert_allclose(result.planes[0].centre, [0, 0, -EYE_M], atol=1e-3)
    for plane in result.planes:
        assert np.linalg.norm(plane.normal) == pytest.approx(1.0, abs=1e-5)
        assert np.linalg.norm(plane.descriptor) == pytest.approx(1.0, abs=1e-4)
        assert 0.0 <= plane.confidence <= 1.0
    assert result.semantics.shape == (256, 12)
    np.testing.assert_allclose(np.linalg.norm(result.normals, axis=1), 1.0, atol=1e-4)


def test_an_empty_scan_gets_an_answer(network: StructureNetwork) -> None:
    ring = RingScan(np.zeros((16, 64, 3), np.uint8), np.zeros((16, 64), np.float32), np.eye(4))
    scan = scan_points(ring, np.random.default_rng(0), 64)
    result = complete_planes(scan, network)
    assert not any(plane.observed for plane in result.planes)
    assert np.isfinite([plane.centre for plane in result.planes]).all()


def test_batches_are_the_same_for_the_same_seed() -> None:
    first, second = batch_of(), batch_of()
    assert all(torch.equal(first[k], second[k]) for k in first)
    assert first.keys() >= set(PointBatch._fields)
    assert given(first).points.shape == (4, 256, 3)
    assert first["wall_plane"].shape == (4, SLOTS)
