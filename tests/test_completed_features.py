"""Features of completed rooms, and the poses that they propose between scans without overlap.

The rooms are exact and their descriptors are codes of places in the world, so that what is tested
is the way from a completed room to a pose and not what a network has learnt.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from fewview.completion import room_matches
from fewview.completion.kinds import ScanView
from fewview.completion.layout.features import THINGS, Layout
from fewview.completion.layout.grid import cell_centres
from fewview.completion.local_geometry import DepthView
from fewview.completion.panorama.features import Panorama, distinctiveness
from fewview.completion.panorama.ring import RingScan, ring_points
from fewview.completion.scan import COMPLETED_KINDS
from fewview.completion.structure.features import Structure
from fewview.config import Config, FeatureConfig, merge
from fewview.geometry import se3
from fewview.matching.completed import completion_poses
from fewview.matching.consistency import consistency_matrix, joined, stack
from fewview.matching.prepared import prepare
from fewview.matching.spectral import top_poses
from fewview.pairwise import weigh_pair
from fewview.synthetic.samples import RoomSample
from fewview.types import (
    Array,
    CandidateOrigin,
    CompletedLayout,
    CompletedPanorama,
    CompletedPlanes,
    CompletedRoom,
    CompletedScan,
    FloatArray,
    Frame,
    Intrinsics,
    Levelling,
    Representation,
    StructuralPlane,
    Surface,
)
from tests.box_rooms import EYE_M, box_room

SIZE = 32
CONFIDENCE = 0.8


def code(places: Array) -> FloatArray:
    """(..., 32) unit descriptors that differ smoothly from place to place."""
    rng = np.random.default_rng(0)
    waves = places @ rng.normal(size=(places.shape[-1], 32)) + rng.uniform(0, 2 * np.pi, 32)
    return np.asarray(np.cos(waves) / np.linalg.norm(np.cos(waves), axis=-1, keepdims=True), "f4")


def completed_scan(room: RoomSample, view: int) -> CompletedScan:
    """A view of a box room as perfect networks would complete it."""
    scan_R_level = room.scan_R_level[view]
    level_T_scan = se3.pose(scan_R_level.T, np.zeros(3))
    world_T_level = se3.inverse(room.level_T_world[view])
    ring = RingScan(room.colour[view], room.measured[view], level_T_scan)
    size = room.depth.shape[1]
    places = se3.transform(world_T_level, ring_points(room.depth[view]).reshape(-1, 3))
    panorama = CompletedPanorama(
        depth=room.depth[view],
        normals=room.normal[view],
        semantics=np.eye(12, dtype=np.float32)[room.semantics[view]],
        descriptors=code(places).reshape(size, 4 * size, 32),
        confidence=np.full((size, 4 * size), CONFIDENCE, np.float32),
        observed=room.observed[view],
        level_T_scan=level_T_scan,
    )
    cells = np.pad(cell_centres().astype(np.float64), ((0, 0), (0, 0), (0, 1)))
    layout = CompletedLayout(
        level_T_scan,
        np.moveaxis(np.eye(5, dtype=np.float32)[room.layout[view]], -1, 0),
        room.layout[view],
        code(se3.transform(world_T_level, cells.reshape(-1, 3))).reshape(64, 64, 32),
        np.full((64, 64), CONFIDENCE, np.float32),
        np.zeros((64, 64), dtype=bool),
        np.array([0.0, 0.0, 1.0, -EYE_M]),
    )
    kinds = {1: "floor", 2: "ceiling", 3: "wall"}
    planes = tuple(
        structural_plane(kinds[int(kind)], plane.astype(np.float64), world_T_level)
        for plane, kind in zip(room.planes[view], room.plane_kind[view], strict=True)
        if kind
    )
    nothing = np.zeros((0, 3), np.float32)
    rooms = CompletedRoom(
        ring, panorama, layout, CompletedPlanes(planes, *(nothing,) * 4, np.zeros(0, np.float32))
    )
    frame = Frame(
        np.zeros((48, 64, 3), np.uint8),
        np.zeros((48, 64), np.float32),
        Intrinsics(64, 48, 50.0, 50.0, 31.5, 23.5),
    )
    depth = DepthView.of(frame, 6.0)
    surface = Surface(*(np.zeros((0, 3)),) * 2, nothing, np.zeros(0, np.int64))
    levelling = Levelling(level_T_scan[:3, :3], 1.0, True, -EYE_M)
    seen = ScanView(frame, 0, depth, surface, (), levelling, rooms)
    return CompletedScan(
        name=str(view),
        image_size=(64, 48),
        quarter_turns=0,
        intrinsics=depth.intrinsics,
        depth=depth.depth,
        surface=surface,
        patches=(),
        levelling=levelling,
        room=rooms,
        features={k.name: k.extract(seen, FeatureConfig()) for k in COMPLETED_KINDS},
    )


def structural_plane(kind: str, plane: Array, world_T_level: Array) -> StructuralPlane:
    """A plane of a box room around the world's origin; its centre is the wall's."""
    normal = world_T_level[:3, :3] @ plane[:3]
    offset = plane[3] + normal @ world_T_level[:3, 3]
    centre = normal * offset + np.array([0.0, 0.0, 1.25 * (kind == "wall")])
    level = se3.transform(se3.inverse(world_T_level), centre[None])[0]
    return StructuralPlane(kind, level, plane[:3], code(centre), CONFIDENCE, False)


@pytest.fixture(scope="module")
def room() -> RoomSample:
    """Two cameras that look in opposite directions and share no wall."""
    return next(
        sample
        for sample in (box_room(seed, 2, SIZE) for seed in range(100))
        if sample.level_T_world[0, :2, 0] @ sample.level_T_world[1, :2, 0] < -0.95
    )


@pytest.fixture(scope="module")
def scans(room: RoomSample) -> list[CompletedScan]:
    return [completed_scan(room, view) for view in range(2)]


@pytest.fixture(scope="module")
def target_T_source(room: RoomSample) -> Array:
    world_T_scan = [
        se3.inverse(level_T_world) @ se3.pose(scan_R_level.T, np.zeros(3))
        for level_T_world, scan_R_level in zip(room.level_T_world, room.scan_R_level, strict=True)
    ]
    return se3.inverse(world_T_scan[1]) @ world_T_scan[0]


@pytest.mark.parametrize("kind", COMPLETED_KINDS, ids=lambda kind: kind.name)
def test_a_feature_is_at_the_place_that_its_descriptor_names(
    kind: Panorama | Layout | Structure, scans: list[CompletedScan], target_T_source: Array
) -> None:
    """Two scans' features with (nearly) one descriptor meet under the true pose."""
    source, target = (scan.features[kind.name] for scan in scans)
    alike = source.descriptors[:, :32] @ target.descriptors[:, :32].T
    best = alike.argmax(axis=1)
    sure = alike.max(axis=1) > 0.98
    assert sure.sum() >= 6
    gap = se3.transform(target_T_source, source.positions) - target.positions[best]
    assert np.linalg.norm(gap[sure], axis=1).max() < 0.3
    turned = se3.rotate(target_T_source, source.normals)
    known = sure & source.normals.any(axis=1) & target.normals[best].any(axis=1)
    assert np.median((turned * target.normals[best]).sum(axis=1)[known]) > 0.95


def test_bare_walls_are_less_distinctive_than_their_edges(room: RoomSample) -> None:
    panorama = completed_scan(room, 0).room.panorama
    assert panorama is not None
    score = distinctiveness(panorama)
    wall = (panorama.semantics.argmax(axis=-1) == 1) & (score < 1e-3)
    table = panorama.semantics.argmax(axis=-1) == 6
    assert wall.mean() > 0.1
    assert score[table].min() >= 1.0


def test_layout_features_stand_on_things_and_face_the_floor(scans: list[CompletedScan]) -> None:
    layout = scans[0].room.layout
    assert layout is not None
    features = scans[0].features["layout"]
    level = se3.transform(layout.level_T_scan, features.positions)
    np.testing.assert_allclose(level[:, 2], 1.0 - EYE_M, atol=1e-6)
    facing = se3.rotate(layout.level_T_scan, features.normals)
    ahead = level + 0.3 * facing
    cell = np.floor((4.0 - ahead[:, :2]) / 0.125).astype(int).clip(0, 63)
    known = facing.any(axis=1)
    assert known.mean() > 0.8
    assert (~np.isin(layout.classes[tuple(cell[known].T)], THINGS)).mean() > 0.9


def test_matches_are_at_one_height_and_lean_alike(scans: list[CompletedScan]) -> None:
    source, target = scans
    matches = Panorama().correspond(source, target)
    up = [scan.levelling.level_R_scan[2] for scan in scans]
    a, b = source.features["panorama"], target.features["panorama"]
    heights = (
        a.positions[matches.indices[:, 0]] @ up[0],
        b.positions[matches.indices[:, 1]] @ up[1],
    )
    lean = a.normals[matches.indices[:, 0]] @ up[0] - b.normals[matches.indices[:, 1]] @ up[1]
    assert len(matches) > 100
    assert np.abs(heights[0] - heights[1]).max() < room_matches.HEIGHT_M
    assert np.abs(lean).max() < room_matches.INCLINATION
    assert matches.similarity.max() <= CONFIDENCE + 1e-6
    assert np.bincount(matches.indices[:, 0]).max() <= room_matches.BEST


def test_of_two_matched_features_one_is_predicted(scans: list[CompletedScan]) -> None:
    features = scans[0].features["panorama"]
    matches = Panorama().correspond(scans[0], scans[0])
    observed = features.observed[matches.indices]
    assert features.observed.sum() > 20
    assert observed.any() and not observed.all(axis=1).any()


def test_the_floor_is_the_seen_one_or_else_predicted(scans: list[CompletedScan]) -> None:
    scan = scans[0]
    unseen = dataclasses.replace(scan.levelling, floor_z=None)
    lower = dataclasses.replace(scan.levelling, floor_z=-2.0)
    bare = CompletedRoom(scan.room.ring)
    assert room_matches.floor_height(dataclasses.replace(scan, levelling=lower)) == -2.0
    predicted = dataclasses.replace(scan, levelling=unseen)
    assert room_matches.floor_height(predicted) == pytest.approx(-EYE_M)
    assert room_matches.floor_height(dataclasses.replace(predicted, room=bare)) is None


@pytest.mark.parametrize("names", [("panorama",), ("layout",), ("panorama", "layout", "structure")])
def test_rooms_completed_alike_propose_the_true_pose(
    names: tuple[str, ...], scans: list[CompletedScan], target_T_source: Array
) -> None:
    found = [k.correspond(*scans) for k in COMPLETED_KINDS if k.name in names]
    matches = stack(scans[0], scans[1], found, 1500, levelled=True)
    best, score = completion_poses(scans[1], matches, 0.0, 5)[0]
    angle, shift = se3.distance(best, target_T_source)
    assert np.degrees(angle) < 5.0 and shift < 0.15 and score > 0.0


def test_proposed_poses_keep_the_vertical_and_have_the_lift(scans: list[CompletedScan]) -> None:
    source, target = scans
    found = [k.correspond(source, target) for k in COMPLETED_KINDS]
    matches = stack(source, target, found, 1500, levelled=True)
    poses = completion_poses(target, matches, -0.1, 5)
    assert poses
    up = [scan.levelling.level_R_scan[2] for scan in (source, target)]
    for pose, _ in poses:
        assert pose[:3, :3] @ up[0] @ up[1] == pytest.approx(1.0, abs=1e-5)
        assert pose[:3, 3] @ up[1] == pytest.approx(-0.1, abs=1e-6)


def test_a_mirrored_room_does_not_match_between_levelled_scans(scans: list[CompletedScan]) -> None:
    """Lengths and unsigned angles cannot tell a room from its mirror image."""
    scan = scans[0]
    found = [Panorama().correspond(scan, scan)]
    free, levelled = (stack(scan, scan, found, 200, levelled=x) for x in (False, True))
    mirror = np.diag([-1.0, 1.0, 1.0])

    def mirrored(matches):
        return dataclasses.replace(
            matches, target=matches.target @ mirror, target_normals=matches.target_normals @ mirror
        )

    assert consistency_matrix(mirrored(free)).sum() == pytest.approx(
        consistency_matrix(free).sum(), rel=1e-3
    )
    assert consistency_matrix(mirrored(levelled)).sum() < 0.5 * consistency_matrix(levelled).sum()


def test_joined_matches_are_those_of_both(scans: list[CompletedScan]) -> None:
    source, target = scans
    first = stack(source, target, [Panorama().correspond(source, target)], 50)
    second = stack(source, target, [Layout().correspond(source, target)], 30, levelled=True)
    both = joined(first, second)
    assert len(both) == 80 and list(both.kinds) == ["panorama", "layout"]
    np.testing.assert_array_equal(both.kind, np.repeat([0, 1], [50, 30]))
    np.testing.assert_array_equal(both.source[50:], second.source)
    assert (both.scale("fixed_point") == 0).all()
    assert top_poses(joined(second, first), consistency_matrix(second), 0) == []


def test_completed_kinds_alone_give_candidates_with_evidence(
    scans: list[CompletedScan], target_T_source: Array
) -> None:
    names = ["panorama", "structure"]
    settings = {"features": {"kinds": names}, "matching": {"manhattan": False}}
    config = merge(Config(), settings, "test")
    source, target = (
        prepare(dataclasses.replace(s, room=dataclasses.replace(s.room, layout=None)))
        for s in scans
    )
    weighed = weigh_pair(source, target, config)
    assert set(weighed.origins) == {CandidateOrigin.COMPLETION}
    best = int(weighed.support.sum(axis=1).argmax())
    angle, shift = se3.distance(weighed.poses[best], target_T_source)
    assert np.degrees(angle) < 5.0 and shift < 0.15
    assert list(weighed.matches.kinds) == names
    assert weighed.evidence[best].support[Representation.PANORAMA] > 50
