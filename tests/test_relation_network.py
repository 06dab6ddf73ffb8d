"""The relation network: what it is given, what it answers, and how it learns."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from box_rooms import box_room

from fewview import weights
from fewview.completion.panorama.network import PanoramaNetwork, PanoramaNetworkConfig
from fewview.completion.panorama.ring import ring_pixels, ring_points
from fewview.evaluation.relations import Relation, perturbed, read_relations
from fewview.geometry import se3
from fewview.refinement.learned_relations import (
    SHARES,
    LearnedRelations,
    network_of,
    points_on_patches,
)
from fewview.refinement.pair_geometry import PosedPairs, pair_geometry, squared_up
from fewview.refinement.relation_network import (
    RELATIONS,
    RelationNetwork,
    RelationNetworkConfig,
    RelationScans,
)
from fewview.refinement.relation_points import (
    OUTSIDE,
    pixel_area,
    relation_points,
    rgb_of_lab,
)
from fewview.synthetic import Split
from fewview.synthetic.samples import RoomSample
from fewview.training import loop, settings
from fewview.training import rooms as rooms_module
from fewview.training.problem import Batch
from fewview.training.relation import RelationProblem
from fewview.training.relation_batch import balanced
from fewview.training.relation_rooms import RelationRoom, mirrored, sampled
from fewview.training.settings import TrainConfig
from fewview.types import (
    Array,
    BoolArray,
    CompletedPanorama,
    CompletedRoom,
    CompletedScan,
    FloatArray,
    IntArray,
    Intrinsics,
    Levelling,
    PlanarPatch,
    RingScan,
    Surface,
)

SMALL = RelationNetworkConfig(local=16, whole=32, image=8, head=16)
PROBLEM = RelationProblem(SMALL, seen=96, predicted=32, pairs=3, relations=64)
SIZE = 64
ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def network() -> RelationNetwork:
    torch.manual_seed(0)
    return RelationNetwork(SMALL).eval()


@pytest.fixture(scope="module")
def panorama() -> PanoramaNetwork:
    torch.manual_seed(0)
    return PanoramaNetwork(PanoramaNetworkConfig(width=16, descriptor=8)).eval()


@pytest.fixture(scope="module")
def rooms(panorama: PanoramaNetwork) -> list[RelationRoom]:
    return [sampled(box_room(i, 3, SIZE), panorama, np.random.default_rng(i)) for i in range(2)]


@pytest.fixture(scope="module")
def batch(rooms: list[RelationRoom]) -> Batch:
    return PROBLEM.batch(rooms, np.random.default_rng(0))


def patched(scan: CompletedScan) -> CompletedScan:
    """The scan with its points, in order, on three patches."""
    labels = np.arange(len(scan.surface.points)) * 3 // len(scan.surface.points)
    patches = []
    for patch in range(3):
        on = labels == patch
        normal = scan.surface.normals[on][0]
        centre = scan.surface.points[on].mean(axis=0)
        patches.append(PlanarPatch(centre, normal, np.ones(2), int(on.sum())))
    surface = dataclasses.replace(scan.surface, labels=labels)
    return dataclasses.replace(scan, surface=surface, patches=tuple(patches))


def scan_of(seed: int, completed: bool = True, points: int = 400) -> CompletedScan:
    """One view of a box-shaped room; the scan's camera looks along y, its level frame along x."""
    room, rng = box_room(seed, 1, SIZE), np.random.default_rng(seed)
    level_T_scan = se3.pose(se3.rotation_exp(np.array([0.1, 0.2, -1.4])), np.zeros(3))
    chosen = rng.permutation(np.flatnonzero(room.measured[0]))[:points]
    at = ring_points(room.depth[0]).reshape(-1, 3)[chosen].astype(np.float64)
    normals = room.normal[0].reshape(-1, 3)[chosen].astype(np.float64)
    lab = cv2.cvtColor(room.colour[0].astype(np.float32) / np.float32(255), cv2.COLOR_RGB2LAB)
    scan_T_level = se3.inverse(level_T_scan)
    surface = Surface(
        se3.transform(scan_T_level, at),
        se3.rotate(scan_T_level, normals),
        lab.reshape(-1, 3)[chosen],
        np.full(len(chosen), -1),
    )
    seen = np.zeros((SIZE, 4 * SIZE), bool)
    seen.flat[chosen] = True
    ring = RingScan(room.colour[0] * seen[..., None], room.depth[0] * seen, level_T_scan)
    around = CompletedPanorama(
        depth=room.depth[0],
        normals=room.normal[0],
        semantics=np.zeros((SIZE, 4 * SIZE, 12), np.float32),
        descriptors=np.zeros((SIZE, 4 * SIZE, 8), np.float32),
        confidence=rng.uniform(0.2, 0.9, seen.shape).astype(np.float32),
        observed=seen,
        level_T_scan=level_T_scan,
    )
    return CompletedScan(
        name=str(seed),
        image_size=(8, 8),
        quarter_turns=0,
        intrinsics=Intrinsics(8, 8, 8.0, 8.0, 3.5, 3.5),
        depth=np.zeros((8, 8), np.float32),
        surface=surface,
        patches=(),
        levelling=Levelling(level_T_scan[:3, :3], 1.0, True, None),
        room=CompletedRoom(ring, around if completed else None),
        features={},
    )


def poses(count: int, seed: int = 0) -> Array:
    rng = np.random.default_rng(seed)
    return np.stack([perturbed(np.eye(4), rng) for _ in range(count)])


def asked(scans: list[CompletedScan], count: int = 50) -> list[IntArray]:
    rng = np.random.default_rng(5)
    return [rng.integers(len(scan.surface.points), size=count) for scan in scans]


def two_scans() -> tuple[RelationScans, PosedPairs]:
    """Scans of different numbers of points under three poses."""
    rng = np.random.default_rng(0)
    few, many = (relation_points(scan_of(i, points=n), rng) for i, n in ((0, 60), (1, 300)))
    pairs = PosedPairs(
        torch.zeros(3, dtype=torch.int64),
        torch.ones(3, dtype=torch.int64),
        torch.from_numpy(poses(3).astype(np.float32)),
        *(torch.randint(len(p.points), (3, 40)) for p in (few, many)),
    )
    return RelationScans.of([few, many]), pairs


def world_planes(
    room: RelationRoom, view: IntArray, points: FloatArray, normals: FloatArray
) -> tuple[IntArray, BoolArray]:
    """The planes of a room along the world's axes that points (..., 3) of views lie on, by axis,
    side and offset in cm (..., 3); and which points have the normal of one (...)."""
    world_T_level = se3.inverse(room.level_T_world)[view]
    normal = (world_T_level[..., :3, :3] @ normals[..., None])[..., 0]
    point = (world_T_level[..., :3, :3] @ points[..., None])[..., 0] + world_T_level[..., :3, 3]
    axis = np.abs(normal).argmax(axis=-1)
    sides, offsets = (
        np.take_along_axis(v, axis[..., None], axis=-1)[..., 0] for v in (normal, point)
    )
    columns = [axis, np.sign(sides).astype(np.int64), np.rint(100 * offsets).astype(np.int64)]
    return np.stack(columns, axis=-1), np.abs(sides) > 0.99


def test_the_classes_are_those_of_the_evaluation() -> None:
    assert tuple(relation.name.lower() for relation in Relation) == RELATIONS


def test_the_order_of_points_does_not_matter(network: RelationNetwork) -> None:
    scans, pairs = two_scans()
    order = torch.randperm(scans.points.shape[1])
    place = order.argsort()
    shuffled = RelationScans(*(v[:, order] for v in scans[:-2]), *scans[-2:])
    renamed = pairs._replace(
        source_point=place[pairs.source_point], target_point=place[pairs.target_point]
    )
    with torch.inference_mode():
        torch.testing.assert_close(
            network.relations(shuffled, renamed), network.relations(scans, pairs)
        )


def test_poses_together_are_poses_one_by_one(network: RelationNetwork) -> None:
    scans, pairs = two_scans()
    with torch.inference_mode():
        together = network(scans, pairs)
        for k in range(3):
            alone = network(scans, PosedPairs(*(values[k : k + 1] for values in pairs)))
            torch.testing.assert_close(alone.relations, together.relations[k : k + 1])
            torch.testing.assert_close(alone.semantics, together.semantics[k : k + 1])
    assert not torch.allclose(together.relations[0], together.relations[1])


def test_points_that_fill_up_do_not_count(network: RelationNetwork) -> None:
    scans, pairs = two_scans()
    more = RelationScans(
        *(torch.cat([v, 7 * torch.ones_like(v[:, :9])], dim=1) for v in scans[:-2]), *scans[-2:]
    )
    more.pooled[:, -9:] = False
    with torch.inference_mode():
        torch.testing.assert_close(network.relations(more, pairs), network.relations(scans, pairs))


def test_geometry_is_that_of_the_rules() -> None:
    """Relations read off the measures are those that the rules read."""
    scans, pairs = two_scans()
    found = pair_geometry(scans.points, scans.normals, pairs).numpy()
    at = [pairs.source[:, None], pairs.source_point, pairs.target[:, None], pairs.target_point]
    for k, pose in enumerate(pairs.target_T_source.double().numpy()):
        a, i, b, j = (index[k] for index in at)
        arrays = (scans.points[a, i], scans.normals[a, i], scans.points[b, j], scans.normals[b, j])
        expected = read_relations(*(v.double().numpy() for v in arrays), pose, 15.0, 0.3)
        cosine, sine, first, second = found[k, :, :4].T
        angle = np.degrees(np.arctan2(sine, cosine))
        near = np.maximum(np.abs(first), np.abs(second)) <= 0.3
        read = np.where(np.minimum(angle, 180 - angle) <= 15.0, Relation.PARALLEL, Relation.NONE)
        read[np.abs(angle - 90.0) <= 15.0] = Relation.PERPENDICULAR
        read[(angle <= 15.0) & near] = Relation.COPLANAR
        np.testing.assert_array_equal(read, expected)


@pytest.mark.parametrize("turns", range(4))
def test_a_perturbed_quarter_turn_is_squared_up(turns: int) -> None:
    true = se3.pose(se3.rotation_exp(np.array([0, 0, turns * np.pi / 2])), np.array([1.0, 2, 3]))
    rng = np.random.default_rng(turns)
    wrong = np.stack([perturbed(true, rng) for _ in range(50)])
    found = squared_up(torch.from_numpy(wrong)).numpy()
    np.testing.assert_allclose(found[:, :3, :3], true[None, :3, :3].repeat(50, 0), atol=1e-12)
    np.testing.assert_array_equal(found[:, :3, 3], wrong[:, :3, 3])


def test_colours_are_those_of_the_image() -> None:
    rgb = np.random.default_rng(0).uniform(size=(500, 3)).astype(np.float32)
    rgb[:3] = [[0, 0, 0], [1, 1, 1], [0.01, 0.02, 0.01]]
    lab = cv2.cvtColor(rgb[None], cv2.COLOR_RGB2LAB)[0]
    np.testing.assert_allclose(rgb_of_lab(lab), rgb, atol=4e-3)


def test_what_a_scan_gives() -> None:
    scan, index = scan_of(0), np.array([7, 7, 3])
    found = relation_points(scan, np.random.default_rng(0), index)
    ring = scan.room.ring
    expected = se3.transform(ring.level_T_scan, scan.surface.points[index])
    np.testing.assert_allclose(found.points[:3], expected, atol=1e-5)
    assert found.pooled.tolist() == [False] * 3 + [True] * (len(found.points) - 3)
    seen = ~found.predicted
    assert (found.confidence[seen] == 1.0).all() and (found.confidence[~seen] < 1.0).all()
    assert found.predicted.any()
    assert (ring.depth.ravel()[found.pixels[seen]] > 0).all()
    assert (ring.depth.ravel()[found.pixels[~seen]] == 0).all()
    shown = ring.colour.reshape(-1, 3)[found.pixels[seen]] / 255.0
    np.testing.assert_allclose(found.colours[seen], shown, atol=0.01)
    bare = relation_points(scan_of(0, completed=False), np.random.default_rng(0))
    assert not bare.predicted.any() and bare.pooled.all()


def test_points_outside_the_ring_have_no_pixel() -> None:
    scan = scan_of(0, completed=False)
    above = se3.transform(se3.inverse(scan.room.level_T_scan), np.array([[0.1, 0.0, 1.0]]))
    surface = dataclasses.replace(
        scan.surface, points=np.concatenate([above, scan.surface.points[1:]])
    )
    found = relation_points(
        dataclasses.replace(scan, surface=surface), np.random.default_rng(0), np.array([0, 1])
    )
    assert found.pixels[0] == OUTSIDE and found.pixels[1] >= 0


def test_area_of_pixels() -> None:
    """Of a wall 2 m ahead and of the floor 1 m below, as far as a ring of 64 shows them."""
    points = ring_points(np.full((64, 256), 2.0, np.float32))[:, 64:128]
    wall = pixel_area(points, np.broadcast_to(np.float32([-1, 0, 0]), points.shape))
    assert wall.sum() * (2 / 64) ** 2 == pytest.approx(16.0, rel=1e-3)
    floor = points[40:] / -points[40:, :, 2:]
    area = pixel_area(floor, np.broadcast_to(np.float32([0, 0, 1]), floor.shape)).sum(axis=1)
    far = 1.0 / (np.arange(40, 64) - np.array([[32.0], [31.0]])) * 32.0
    np.testing.assert_allclose(area[5:] / 1024, (far[0] ** 2 - far[1] ** 2)[5:], rtol=0.01)


def test_labels_are_those_of_the_rooms_planes(rooms: list[RelationRoom]) -> None:
    """Of seen points that do not lie in the corners, where measured normals are mixed."""
    upright = dataclasses.replace(PROBLEM, tilt_deg=0.0)
    found = {k: v.numpy() for k, v in upright.batch(rooms[:1], np.random.default_rng(1)).items()}
    compared, planes = found["known"], []
    for side in ("source", "target"):
        at = (found[side][:, None], found[f"{side}_point"])
        plane, plain = world_planes(rooms[0], at[0], found["points"][at], found["normals"][at])
        compared = compared & plain & ~found["predicted"][at]
        planes.append(plane)
    a, b = planes
    expected = np.where(a[..., 0] == b[..., 0], Relation.PARALLEL, Relation.PERPENDICULAR)
    expected[(a == b).all(axis=-1)] = Relation.COPLANAR
    assert np.unique(expected[compared]).tolist() == [1, 2, 3]
    np.testing.assert_array_equal(found["relation"][compared], expected[compared])


def test_classes_are_balanced(batch: Batch) -> None:
    assert batch["relation"].shape == (6, 64)
    for relation in Relation:
        rows = batch["known"] & (batch["relation"] == relation)
        assert set(rows.sum(dim=1).tolist()) <= {0, 16}
    labels = np.repeat([0, 1, 3], [900, 5, 95])
    allowed = np.ones(1000, bool)
    allowed[0] = False
    chosen, known = balanced(labels, allowed, 400, np.random.default_rng(0))
    counts = np.bincount(labels[chosen[known]], minlength=4)
    np.testing.assert_array_equal(counts, [100, 100, 0, 100])
    assert 0 not in chosen[known]


def test_a_mirrored_room_has_the_same_relations(rooms: list[RelationRoom]) -> None:
    room, other = rooms[0], mirrored(rooms[0])
    plain, turned = (PROBLEM.batch([r], np.random.default_rng(0)) for r in (room, other))
    for name in ("relation", "known", "source_point", "target_point", "semantics"):
        assert torch.equal(plain[name], turned[name])
    twice = mirrored(other)
    for name, array in vars(room).items():
        np.testing.assert_allclose(getattr(twice, name), array, atol=1e-9)
    for each in (room, other):
        pixel, _, inside = ring_pixels(each.points, SIZE)
        expected = np.where(inside, pixel, OUTSIDE)
        assert (expected == each.pixels).mean() > 0.99


def test_no_truth_reaches_the_input(panorama: PanoramaNetwork) -> None:
    room, rng = box_room(4, 2, SIZE), np.random.default_rng(0)
    seen = room.measured > 0
    noise = rng.integers(256, size=room.colour.shape).astype(np.uint8)
    other = dataclasses.replace(
        room,
        depth=1.3 * room.depth,
        normal=room.normal[..., [1, 2, 0]],
        colour=np.where(seen[..., None], room.colour, noise),
        semantics=np.zeros_like(room.semantics),
        observed=np.ones_like(room.observed),
        planes=0 * room.planes,
    )
    first, second = (
        PROBLEM.batch([sampled(r, panorama, np.random.default_rng(0))], np.random.default_rng(0))
        for r in (room, other)
    )
    for name in (*RelationScans._fields, "source", "target", "target_T_source"):
        assert torch.equal(first[name], second[name]), name
    assert not torch.equal(first["relation"], second["relation"]) or not torch.equal(
        first["semantics"], second["semantics"]
    )


def test_a_view_that_measured_nothing_teaches_nothing(panorama: PanoramaNetwork) -> None:
    room = box_room(0, 2, SIZE)
    room.measured[1] = 0
    blind = sampled(room, panorama, np.random.default_rng(0))
    found = PROBLEM.batch([blind], np.random.default_rng(0))
    assert found["pooled"].any(dim=1).tolist() == [True, False]
    assert not found["known"].any()
    network = PROBLEM.network()
    assert float(PROBLEM.losses(network, found)["relation"].detach()) == 0.0
    assert np.isnan(PROBLEM.metrics(network, found)["seen_mean"])


def test_losses_fall_and_figures_are_shares(batch: Batch) -> None:
    torch.manual_seed(0)
    learner = PROBLEM.network()
    optimiser = torch.optim.Adam(learner.parameters(), 5e-3)
    totals = []
    for _ in range(15):
        parts = PROBLEM.losses(learner, batch)
        optimiser.zero_grad()
        torch.stack(list(parts.values())).sum().backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        totals.append({name: float(value.detach()) for name, value in parts.items()})
    assert set(totals[0]) == {"relation", "semantics"}
    assert all(totals[-1][name] < 0.9 * totals[0][name] for name in totals[0])
    with torch.inference_mode():
        figures = PROBLEM.metrics(learner.eval(), batch)
    shares = [value for value in figures.values() if np.isfinite(value)]
    assert len(shares) >= 6
    assert all(0.0 <= value <= 1.0 for value in shares)


def test_a_prediction_is_repeated_exactly(network: RelationNetwork) -> None:
    scans = [patched(scan_of(0)), patched(scan_of(1))]
    predictor = LearnedRelations(network)
    first, second = (predictor.predict(*scans, poses(3)) for _ in range(2))
    for name, values in vars(first).items():
        np.testing.assert_array_equal(values, getattr(second, name))
    count = len(scans[0].patches) * len(scans[1].patches)
    assert first.source.shape == (count, 3) and first.coplanar.shape == (3, count)
    total = first.coplanar + first.parallel + first.perpendicular
    assert (total < 1.0).all() and (first.coplanar > 0.0).all()
    assert not np.array_equal(first.coplanar[0], first.coplanar[1])
    alone = predictor.predict(*scans, poses(3)[1:2])
    np.testing.assert_allclose(alone.parallel[0], first.parallel[1], atol=1e-6)


def test_the_network_is_asked_about_points_of_the_patches() -> None:
    """Of every pair, each point of one patch with one of the other; answers are averaged."""
    scans = [patched(scan_of(0)), patched(scan_of(1))]
    rows = [points_on_patches(scan, 5, np.random.default_rng(0)) for scan in scans]
    for scan, index in zip(scans, rows, strict=True):
        expected = np.repeat(np.arange(len(scan.patches)), 5)
        np.testing.assert_array_equal(scan.surface.labels[index], expected)


def test_what_points_say_is_averaged_and_weighed_by_how_frequent_relations_are(
    network: RelationNetwork,
) -> None:
    scans = [patched(scan_of(0)), patched(scan_of(1))]
    found = LearnedRelations(network, samples=3).predict(*scans, poses(2))
    rng = np.random.default_rng(0)
    asked = [points_on_patches(scan, 3, rng).reshape(-1, 3) for scan in scans]
    chance = LearnedRelations(network).of_surface(*scans, poses(2), asked[0][1], asked[1][2])
    chance = chance * SHARES
    mean = (chance / chance.sum(axis=-1, keepdims=True)).mean(axis=1)
    pair = len(scans[1].patches) + 2
    np.testing.assert_allclose(found.coplanar[:, pair], mean[:, 1], atol=1e-5)
    np.testing.assert_allclose(found.perpendicular[:, pair], mean[:, 3], atol=1e-5)


def test_answers_do_not_depend_on_what_else_is_asked(network: RelationNetwork) -> None:
    scans = [scan_of(0), scan_of(1)]
    i, j = asked(scans)
    predictor = LearnedRelations(network)
    every = predictor.of_surface(*scans, poses(2), i, j)
    some = predictor.of_surface(*scans, poses(2), i[10:20], j[10:20])
    assert every.shape == (2, 50, 4)
    np.testing.assert_allclose(every.sum(axis=-1), 1.0, atol=1e-6)
    np.testing.assert_allclose(some, every[:, 10:20], atol=1e-6)


@pytest.mark.parametrize("completed", [True, False])
def test_empty_scans(network: RelationNetwork, completed: bool) -> None:
    scan, empty = scan_of(0, completed), scan_of(1, completed, points=0)
    for pair in ((scan, empty), (empty, scan), (empty, empty)):
        found = LearnedRelations(network).predict(*pair, poses(2))
        assert found.coplanar.shape == (2, 0)
        nobody = np.zeros(0, np.int64)
        assert LearnedRelations(network).of_surface(*pair, poses(2), nobody, nobody).size == 0
    whole = patched(scan) if completed else scan
    found = LearnedRelations(network).predict(whole, whole, poses(1)[:0])
    assert found.coplanar.shape == (0, len(found.weight))


def test_a_run_learns_from_rooms_sampled_once(
    panorama: PanoramaNetwork, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[int] = []

    def generated(split: Split, index: int, views: int, size: int, library: None) -> RoomSample:
        made.append(index)
        return box_room(index, views, SIZE)

    monkeypatch.setattr(rooms_module, "generated", generated)
    size = dataclasses.asdict(panorama.config)
    card = {"config": {"settings": {"size": size}}}
    weights.save("panorama", tmp_path, panorama.state_dict(), card)
    problem = dataclasses.replace(PROBLEM, weights=str(tmp_path), pairs=2)
    config = TrainConfig(
        "relation",
        problem,
        steps=4,
        rooms=1,
        views=2,
        made_views=3,
        pool=2,
        validation_rooms=1,
        store=str(tmp_path / "rooms"),
    )
    loop.train(config, tmp_path / "run", device="cpu", jobs=0)
    loop.train(config, tmp_path / "again", device="cpu", jobs=0)
    assert sorted(made) == [0, 0, 1]
    state, trained = weights.load("relation", tmp_path / "run")
    network_of(trained["config"]["settings"]["size"]).load_state_dict(state)


def test_the_shipped_settings_are_read() -> None:
    found = settings.load(ROOT / "configs" / "train_relation.yaml").settings
    assert isinstance(found, RelationProblem)
    assert found.size == RelationNetworkConfig()
