"""Evidence on constructed scenes; probabilities; Manhattan candidates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fewview import synthetic
from fewview.completion import complete
from fewview.config import FeatureConfig
from fewview.geometry import se3
from fewview.geometry.camera import backproject
from fewview.matching.heights import lift
from fewview.matching.manhattan import manhattan_poses
from fewview.matching.prepared import PreparedScan, prepare
from fewview.probability import ProbabilityModel, shipped_model
from fewview.refinement import evidence
from fewview.types import Array, Frame, Intrinsics

CAMERA = Intrinsics(320, 240, 280.0, 280.0, 159.5, 119.5)


def wall_scan(distance: float) -> PreparedScan:
    """A camera that sees nothing but a wall in front of it."""
    rng = np.random.default_rng(0)
    colour = rng.integers(0, 255, (240, 320, 3), dtype=np.uint8)
    depth = np.full((240, 320), distance, dtype=np.float32)
    return prepare(complete("wall", Frame(colour, depth, CAMERA), 0, FeatureConfig(), 0))


def shifted(z: float) -> np.ndarray:
    pose = np.eye(4)
    pose[2, 3] = z
    return pose[None]


def test_points_on_the_seen_surface_agree() -> None:
    wall = wall_scan(2.0)
    seen = evidence.visible_agreement(wall, wall, shifted(0.0))
    assert seen.count[0] > 500
    assert seen.on_surface[0] == pytest.approx(1.0) and seen.in_front[0] == 0.0


def test_points_in_seen_free_space_are_contradictions() -> None:
    """A wall at 2 m moved 0.8 m towards a camera that looked through to 2 m stands in the way;
    seen from the other camera the same motion hides the wall behind the measured one."""
    wall = wall_scan(2.0)
    nearer = evidence.visible_agreement(wall, wall, shifted(-0.8))
    assert 0.2 < nearer.in_front[0] < 0.8
    assert nearer.on_surface[0] == 0.0


def test_points_behind_the_seen_surface_are_no_contradiction() -> None:
    near, far = wall_scan(1.0), wall_scan(3.0)
    seen = evidence._seen_by(near, far.sample[None], far.sample_upright)
    assert seen[0] > 300 and seen[1] == 0 and seen[2] == 0


def test_unmeasured_pixels_say_nothing() -> None:
    wall = wall_scan(2.0)
    blind = prepare(
        complete(
            "blind",
            Frame(np.zeros((240, 320, 3), np.uint8), np.zeros((240, 320), np.float32), CAMERA),
            0,
            FeatureConfig(),
            0,
        )
    )
    seen = evidence._seen_by(blind, wall.sample[None], wall.sample_upright)
    assert seen.sum() == 0


def test_overlap_and_residual_of_shifted_walls() -> None:
    wall = wall_scan(2.0)
    agreement = evidence.surface_agreement(
        wall, wall, np.concatenate([shifted(0.0), shifted(0.05), shifted(0.5)])
    )
    assert agreement.overlap[0] > 0.95 and agreement.overlap[2] == 0.0
    assert agreement.residual_m[0] < 0.005
    assert agreement.residual_m[1] == pytest.approx(0.05, abs=0.01)


def striped_wall(contrast: int) -> PreparedScan:
    """A camera that looks straight at a wall with upright stripes, 0.4 m each at 2 m."""
    light = (np.arange(320) * 2.0 / CAMERA.fx / 0.4).astype(int) % 2
    colour = np.tile((100 + contrast * light).astype(np.uint8)[None, :, None], (240, 1, 3))
    depth = np.full((240, 320), 2.0, dtype=np.float32)
    return prepare(complete("stripes", Frame(colour, depth, CAMERA), 0, FeatureConfig(), 0))


def test_colours_agree_in_the_right_place_and_not_a_stripe_further() -> None:
    along = np.tile(np.eye(4), (4, 1, 1))
    along[:, 0, 3] = (0.0, 0.2, 0.4, 0.8)
    wall = striped_wall(100)
    right, between, wrong, periodic = evidence.surface_agreement(wall, wall, along).concordance
    assert right > 0.9 and periodic > 0.6
    assert abs(between) < 0.2 and wrong < -0.6


def test_colours_of_plain_walls_say_nothing() -> None:
    plain, far = striped_wall(1), np.eye(4)[None].copy()
    far[0, 2, 3] = 3.0
    both = np.concatenate([np.eye(4)[None], far])
    found = evidence.surface_agreement(plain, plain, both).concordance
    assert abs(found[0]) < 0.1 and found[1] == 0.0


def test_gravity_disagreement_is_the_tilt() -> None:
    levelling = wall_scan(2.0).scan.levelling
    tilted = se3.exp(np.array([[0.0, 0.0, 0.3, 0.0, 0.0, 0.0]]))
    tilt, gap = evidence.gravity_disagreement(levelling, levelling, tilted)
    assert tilt[0] == pytest.approx(0.3, abs=1e-6) and gap[0] == 0.0


@pytest.fixture(scope="module")
def room_views() -> tuple[list[PreparedScan], list[np.ndarray]]:
    """One standing place in a generated room, looked at in two directions 40 degrees apart."""
    room = synthetic.make_room(synthetic.split_seed("test", 4))
    camera = synthetic.kinect(640, 480)
    first = synthetic.sample_views(room, 1, 0, "random")[0]
    second = first.copy()
    second[:3, :3] = se3.rotation_exp(np.array([0.0, 0.0, np.radians(40)])) @ first[:3, :3]
    poses = [first, second]
    frames = [
        synthetic.render(room, p, camera, np.random.default_rng(i)) for i, p in enumerate(poses)
    ]
    scans = [prepare(complete(str(i), f, 0, FeatureConfig(), 0)) for i, f in enumerate(frames)]
    return scans, poses


def test_manhattan_candidates_hold_the_right_yaw_and_its_turns(
    room_views: tuple[list[PreparedScan], list[np.ndarray]],
) -> None:
    (a, b), (world_T_a, world_T_b) = room_views
    source_lift = lift(a.scan, b.scan, a.heights, b.heights)
    levels = a.scan.levelling, b.scan.levelling
    found = manhattan_poses(a.raster, b.raster, *levels, source_lift)
    truth = se3.inverse(world_T_b) @ world_T_a
    errors = [se3.distance(pose, truth) for pose, _ in found]
    assert any(np.degrees(turn) < 4 and shift < 0.3 for turn, shift in errors)
    turns = np.degrees([turn for turn, _ in errors])
    assert (np.abs(turns - np.round(turns / 90) * 90) < 6).all()
    scores = [score for _, score in found]
    assert scores == sorted(scores, reverse=True)


def test_no_manhattan_candidates_without_walls() -> None:
    scan = wall_scan(2.0)
    unlevelled = type(scan.scan.levelling)(np.eye(3), 0.0, False, None)
    assert manhattan_poses(scan.raster, scan.raster, unlevelled, scan.scan.levelling, 0.0) == []


def test_depth_image_points_project_onto_themselves() -> None:
    wall = wall_scan(2.0)
    points = backproject(wall.scan.depth, wall.scan.intrinsics).reshape(1, -1, 3).astype(float)
    inside = points[:, (points[0, :, 2] > 0)]
    seen = evidence._seen_by(wall, inside, np.zeros(inside.shape[1], dtype=bool))
    assert seen[1] == seen[0] == inside.shape[1]


@given(st.lists(st.floats(-30, 30), min_size=1, max_size=6))
def test_probabilities_of_a_pair_stay_below_one(values: list[float]) -> None:
    model = logit(("x",), np.zeros(1), np.ones(1), -1.0)
    p = model.probabilities([{"x": v} for v in values])
    assert (p >= 0).all() and p.sum() <= 1.0 + 1e-12
    assert np.argmax(p) == np.argmax(values) or np.isclose(p.max(), p[np.argmax(values)])


def test_what_was_not_measured_says_nothing() -> None:
    model = logit(("x", "y"), np.array([1.0, 5.0]), np.array([1.0, 2.0]), 0.0)
    np.testing.assert_allclose(model.logits([{"x": 3.0}, {"x": 3.0, "y": 6.0}]), [2.0, 4.0])


def test_evidence_far_out_says_no_more_than_much_evidence() -> None:
    model = logit(("x",), np.zeros(1), np.ones(1), 0.0)
    np.testing.assert_allclose(model.logits([{"x": 4.0}, {"x": 400.0}]), [4.0, 4.0])


def test_evidence_can_count_only_beside_other_evidence() -> None:
    both = replace(
        logit(("x", "y"), np.zeros(2), np.zeros(2), 0.0),
        inner=np.array([[3.0, 3.0]]),
        inner_offsets=np.array([-3.0]),
        outer=np.array([1.0]),
    )
    none, one, two = both.logits([{"x": 0, "y": 0}, {"x": 1, "y": 0}, {"x": 1, "y": 1}])
    assert two - one > 0.95 and two - none == pytest.approx(2 * np.tanh(3.0))


def logit(
    names: tuple[str, ...], mean: Array, weights: Array, intercept: float
) -> ProbabilityModel:
    """A model without inner units."""
    d = len(names)
    nothing = {"inner": np.zeros((1, d)), "inner_offsets": np.zeros(1), "outer": np.zeros(1)}
    return ProbabilityModel(names, mean, np.ones(d), weights, intercept, **nothing)


@pytest.mark.parametrize("kind", ["observed", "completed"])
def test_shipped_coefficients_say_how_they_were_made(kind: str) -> None:
    import json
    from importlib import resources

    text = (resources.files("fewview") / "weights" / f"probability_{kind}.json").read_text()
    values = json.loads(text)
    assert values["made"]["by"] == "scripts/fit_probability.py"
    assert not set(values["made"]["scenes"]) & set(values["made"]["checked_on"])
    model = shipped_model(kind == "completed")
    assert len(model.features) == len(model.coefficients) == len(model.mean)
    assert model.inner.shape == (len(model.outer), len(model.features))
    assert (model.scale > 0).all()
