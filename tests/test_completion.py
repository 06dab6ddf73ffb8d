"""Features of what a scan shows: normals, patches, levelling, orientation, keypoints."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping

import numpy as np
import pytest

from fewview import synthetic
from fewview.completion import complete
from fewview.completion.levelling import doubted, level, upright
from fewview.completion.local_geometry import DepthView, reduce_depth, thin_surface
from fewview.completion.orientation import (
    chosen_turns,
    glance,
    match_votes,
    quarter_turns,
    upright_cues,
)
from fewview.completion.patches import find_patches
from fewview.completion.scan import COMPLETED_KINDS, OBSERVED_KINDS
from fewview.completion.xfeat import turn_pixels
from fewview.config import Config, FeatureConfig, merge
from fewview.errors import ConfigError
from fewview.geometry import se3
from fewview.matching.prepared import prepare
from fewview.pairwise import match_pair
from fewview.refinement.local import refine_alone
from fewview.types import (
    Array,
    CompletedScan,
    Frame,
    Intrinsics,
    Levelling,
    Representation,
    Surface,
)
from tests.turning import turned_frame

CONFIG = FeatureConfig()


@pytest.fixture(scope="module")
def scene() -> synthetic.SyntheticScene:
    return synthetic.generate(synthetic.split_seed("test", 7), 3, seed=1, mode="spread")


@pytest.fixture(scope="module")
def completed(scene: synthetic.SyntheticScene) -> list[CompletedScan]:
    return [complete(n, f, 0, CONFIG, 0) for n, f in zip(scene.names, scene.frames, strict=True)]


def arrays_of(value: object) -> Iterator[np.ndarray]:
    """All arrays within nested dataclasses, tuples and mappings."""
    if isinstance(value, np.ndarray):
        yield value
    elif dataclasses.is_dataclass(value):
        yield from arrays_of(tuple(getattr(value, f.name) for f in dataclasses.fields(value)))
    elif isinstance(value, tuple | Mapping):
        for part in value.values() if isinstance(value, Mapping) else value:
            yield from arrays_of(part)


def test_arrays_lie_in_memory_as_they_are_read_back(completed: list[CompletedScan]) -> None:
    """The last bit of a sum can depend on it, and with it whether stored scans give the same."""
    found = [array for scan in completed for array in arrays_of(scan)]
    assert len(found) > 100
    assert all(array.flags.c_contiguous for array in found)


def test_dense_descriptors_go_when_features_are_taken(completed: list[CompletedScan]) -> None:
    for scan in completed:
        for part in (scan.room.panorama, scan.room.layout, scan.room.planes):
            assert part is not None
            assert part.descriptors.shape == (*part.confidence.shape, 0)


def slanted_wall(tilt_deg: float) -> Frame:
    """A plane through (0, 0, 2) turned about the vertical axis."""
    intrinsics = Intrinsics(320, 240, 280.0, 280.0, 159.5, 119.5)
    v, u = np.indices((240, 320))
    ray = np.stack([(u - 159.5) / 280.0, (v - 119.5) / 280.0, np.ones((240, 320))], axis=-1)
    normal = np.array([np.sin(np.radians(tilt_deg)), 0.0, -np.cos(np.radians(tilt_deg))])
    depth = (normal @ [0.0, 0.0, 2.0]) / (ray @ normal)
    depth[(depth < 0) | (depth > 5)] = 0
    return Frame(np.full((240, 320, 3), 128, np.uint8), depth.astype(np.float32), intrinsics)


@pytest.mark.parametrize("tilt", [0.0, 30.0, 55.0])
def test_normals_of_a_plane(tilt: float) -> None:
    frame = slanted_wall(tilt)
    surface = thin_surface(DepthView.of(frame, 6.0), frame.colour, 0.05)
    expected = [np.sin(np.radians(tilt)), 0.0, -np.cos(np.radians(tilt))]
    assert len(surface.points) > 200
    assert (surface.normals @ expected > np.cos(np.radians(2.0))).mean() > 0.99


def test_reduced_depth_is_the_median_of_what_was_measured() -> None:
    depth = np.array([[1.0, 0.0, 5.0, 5.0], [1.2, 9.0, 0.0, 0.0]], dtype=np.float32)
    reduced, camera = reduce_depth(depth, Intrinsics(4, 2, 4.0, 4.0, 1.5, 0.5), 2)
    np.testing.assert_allclose(reduced, [[1.2, 5.0]])
    assert (camera.width, camera.height) == (2, 1)
    np.testing.assert_allclose([camera.cx, camera.cy], [0.5, 0.0])


def test_patches_lie_on_their_points(completed: list[CompletedScan]) -> None:
    for scan in completed:
        assert len(scan.patches) >= 2
        for i, patch in enumerate(scan.patches):
            points = scan.surface.points[scan.surface.labels == i]
            assert len(points) == patch.count
            offset = np.abs((points - patch.centre) @ patch.normal)
            assert np.median(offset) < 0.02
            assert patch.normal @ patch.centre < 0, "normals point towards the camera"


def test_levelling_finds_up_and_floor(
    scene: synthetic.SyntheticScene, completed: list[CompletedScan]
) -> None:
    for name, scan in zip(scene.names, completed, strict=True):
        world_T_scan = scene.poses[name]
        up = world_T_scan[:3, :3] @ scan.levelling.level_R_scan[2]
        assert np.degrees(np.arccos(up[2])) < 2.0
        if scan.levelling.floor_z is not None:
            assert abs(scan.levelling.floor_z + world_T_scan[2, 3]) < 0.06


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_levelling_follows_the_turn_of_the_image(
    scene: synthetic.SyntheticScene, completed: list[CompletedScan], turns: int
) -> None:
    frame, turned_R_scan = turned_frame(scene.frames[0], turns)
    scan = complete("turned", frame, (-turns) % 4, CONFIG, 0)
    up = turned_R_scan.T @ scan.levelling.level_R_scan[2]
    assert up @ completed[0].levelling.level_R_scan[2] > np.cos(np.radians(2.0))


def test_upright_axes_are_the_camera_axes() -> None:
    np.testing.assert_allclose(upright(0), [0, -1, 0])
    for turns in range(4):
        frame = Frame(
            np.zeros((2, 4, 3), np.uint8), np.ones((2, 4), np.float32), Intrinsics(4, 2, 1, 1, 2, 1)
        )
        _, turned_R_scan = turned_frame(frame, turns)
        np.testing.assert_allclose(turned_R_scan @ upright(0), upright(-turns), atol=1e-12)


def test_quarter_turns_are_recovered(scene: synthetic.SyntheticScene) -> None:
    applied = [0, 1, 2, 0]
    frames = [turned_frame(scene.frames[0], k)[0] for k in applied]
    found = quarter_turns([glance(f) for f in frames])
    np.testing.assert_array_equal(found, [(-k) % 4 for k in applied])


def test_upright_images_are_left_as_they_are(scene: synthetic.SyntheticScene) -> None:
    np.testing.assert_array_equal(quarter_turns([glance(f) for f in scene.frames]), 0)


def votes_of(found: dict[tuple[int, int], list[float]], count: int) -> Array:
    """(n, n, 4) of a few matches at every turn, but for the pairs named."""
    everything = np.tile([6.0, 5.0, 9.0, 6.0], (count, count, 1))
    for pair, told in found.items():
        everything[pair] = told
    return match_votes(everything)


def test_many_matches_turn_an_image_and_many_hints_do_not() -> None:
    unknown = np.log(np.full((12, 4), 0.25))
    np.testing.assert_array_equal(chosen_turns(votes_of({}, 12), unknown), 0)
    sure = votes_of({(2, 7): [8.0, 120.0, 5.0, 6.0]}, 12)
    np.testing.assert_array_equal(np.flatnonzero(chosen_turns(sure, unknown)), [7])
    assert chosen_turns(sure, unknown)[7] == 1


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_all_images_together_say_that_they_lie_on_their_side(turns: int) -> None:
    hint = np.roll(np.log([0.55, 0.15, 0.15, 0.15]), turns)
    votes = np.zeros((8, 8, 4))
    np.testing.assert_array_equal(chosen_turns(votes, np.tile(hint, (8, 1))), turns)
    np.testing.assert_array_equal(chosen_turns(votes[:3, :3], np.tile(hint, (3, 1))), 0)


@pytest.mark.parametrize("turns", range(4))
def test_cues_turn_with_the_image(scene: synthetic.SyntheticScene, turns: int) -> None:
    as_taken = upright_cues(scene.frames[0])
    turned = upright_cues(turned_frame(scene.frames[0], turns)[0])
    np.testing.assert_allclose(turned, np.roll(as_taken, -turns, axis=0), atol=0.03)


@pytest.mark.parametrize("turns", range(4))
def test_turned_pixels_show_the_same_content(turns: int) -> None:
    image = np.arange(12).reshape(3, 4)
    rows, columns = np.indices(image.shape)
    pixels = np.stack([columns.ravel(), rows.ravel()], axis=1).astype(np.float32)
    moved = turn_pixels(pixels, 4, 3, turns).astype(int)
    np.testing.assert_array_equal(np.rot90(image, turns)[moved[:, 1], moved[:, 0]], image.ravel())


def test_features_lie_on_the_surface(completed: list[CompletedScan]) -> None:
    for scan in completed:
        assert set(scan.features) == set(CONFIG.kinds)
        for features in scan.features.values():
            assert np.isfinite(features.positions).all()
            length = np.linalg.norm(features.normals, axis=1)
            assert ((np.abs(length - 1.0) < 1e-6) | (length == 0.0)).all()
            assert (length > 0.0).mean() > 0.1
        assert all(scan.features[kind.name].observed.all() for kind in OBSERVED_KINDS)
        assert not all(scan.features[kind.name].observed.all() for kind in COMPLETED_KINDS)


def test_only_the_chosen_kinds_are_extracted_and_matched(scene: synthetic.SyntheticScene) -> None:
    config = merge(Config(), {"features": {"kinds": ["planes"]}}, "test")
    names = scene.names[:2]
    source, target = (
        prepare(complete(n, f, 0, config.features, 0))
        for n, f in zip(names, scene.frames, strict=False)
    )
    assert list(source.scan.features) == ["planes"]
    for candidate in match_pair(source, target, (0, 1), config).candidates:
        assert candidate.evidence.support[Representation.KEYPOINTS] == 0
        assert set(candidate.matches) == {"planes"}


def test_local_module_alone_brings_a_scan_back_onto_itself(
    completed: list[CompletedScan],
) -> None:
    scan = prepare(completed[0])
    start = se3.exp(np.array([[0.03, -0.02, 0.02, 0.05, -0.04, 0.05]]))
    refined = refine_alone(scan, scan, start, Config().refinement)
    angle, shift = se3.distance(refined, np.eye(4))
    assert np.degrees(angle[0]) < 0.5 and shift[0] < 0.02


def test_an_unknown_kind_is_refused(scene: synthetic.SyntheticScene) -> None:
    config = FeatureConfig(kinds=("planes", "smell"))
    with pytest.raises(ConfigError, match="unknown kind 'smell'; there are xfeat, sift, planes"):
        complete("a", scene.frames[0], 0, config, 0)


def test_a_scan_matches_itself(completed: list[CompletedScan]) -> None:
    scan = completed[0]
    for kind in OBSERVED_KINDS:
        if kind.name == "planes":
            continue
        matches = kind.correspond(scan, scan)
        same = matches.indices[:, 0] == matches.indices[:, 1]
        assert len(matches) > 30 and same.mean() > 0.95


def test_scan_without_depth_completes_to_nothing(scene: synthetic.SyntheticScene) -> None:
    frame = scene.frames[0]
    blind = dataclasses.replace(frame, depth=np.zeros_like(frame.depth))
    scan = complete("blind", blind, 0, CONFIG, 0)
    assert len(scan.surface.points) == 0
    assert scan.levelling.up_confidence == 0.0 and scan.levelling.floor_z is None
    assert not scan.room.completed
    assert all(len(f) == 0 for f in scan.features.values())
    assert all(len(kind.correspond(scan, scan)) == 0 for kind in COMPLETED_KINDS)


def test_level_is_deterministic(completed: list[CompletedScan]) -> None:
    scan = completed[0]
    again = level(scan.surface, scan.patches)
    np.testing.assert_array_equal(again.level_R_scan, scan.levelling.level_R_scan)


def test_scattered_coplanar_points_are_no_patch() -> None:
    """Enough points on one plane, but no piece of it is large enough."""
    grid = np.stack(np.meshgrid(np.arange(10), np.arange(10)), axis=-1).reshape(-1, 2)
    points = np.column_stack([grid, np.full(100, 3.0)])
    normals = np.tile([0.0, 0.0, -1.0], (100, 1))
    surface = Surface(points, normals, np.zeros((100, 3), np.float32), np.full(100, -1))
    labelled, patches = find_patches(surface, 5, np.random.default_rng(0))
    assert patches == ()
    assert (labelled.labels == -1).all()


@pytest.mark.parametrize(("predicted", "believed"), [(-1.5, True), (-1.1, False), (-1.9, False)])
def test_a_floor_far_from_the_predicted_one_is_doubted(predicted: float, believed: bool) -> None:
    seen = Levelling(np.eye(3), 0.9, True, -1.45)
    assert doubted(seen, predicted).floor_z == (-1.45 if believed else None)
    unseen = dataclasses.replace(seen, floor_z=None)
    assert doubted(unseen, predicted) == unseen
