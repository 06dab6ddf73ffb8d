"""What is drawn is where it should be, and the same input gives the same bytes."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from benchmark import curves, draw, page, rendering
from fewview.evaluation.calibration import reliability
from fewview.evaluation.metrics import relative
from fewview.geometry import se3
from fewview.synthetic import SyntheticScene, generate, split_seed
from fewview.types import Array

RED, GREEN, BLUE = (255, 0, 0), (0, 255, 0), (0, 0, 255)
SIZE = (120, 90)
FRONT = rendering.View(np.eye(4), 10.0, (101, 81))
UP = np.array([0.0, 0.0, 1.0])


def colours(*values: tuple[int, int, int]) -> rendering.Picture:
    return np.array(values, np.uint8)


@pytest.fixture(scope="module")
def scene() -> SyntheticScene:
    return generate(split_seed("validation", 3), 3, 0, width=160, height=120)


@pytest.fixture(scope="module")
def truth(scene: SyntheticScene) -> list[Array]:
    return [scene.poses[name] for name in scene.names]


def test_a_point_lands_on_its_pixel() -> None:
    point = np.array([[1.5, -2.0, 4.0]])
    image = rendering.cloud_image(point, colours(RED), FRONT, radius=0)
    assert image.shape == (81, 101, 3)
    drawn = np.argwhere(np.any(image != rendering.BACKGROUND, axis=-1))
    assert drawn.tolist() == [[40 - 20, 50 + 15]]
    assert tuple(image[20, 65]) == RED


def test_a_splat_covers_its_square() -> None:
    image = rendering.cloud_image(np.array([[0.0, 0.0, 1.0]]), colours(RED), FRONT, radius=2)
    assert np.all(image[38:43, 48:53] == RED)
    assert np.sum(np.all(image == RED, axis=-1)) == 25


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_nearer_point_hides_the_farther(order: tuple[int, int]) -> None:
    points = np.array([[0.0, 0.0, 2.0], [0.1, 0.0, 1.0]])[list(order)]
    image = rendering.cloud_image(points, colours(RED, GREEN)[list(order)], FRONT)
    assert np.all(image[39:42, 50:53] == GREEN)
    assert image[40, 49, 0] > 0 and image[40, 49, 1] == 0  # what the nearer one leaves free


def test_what_lies_behind_the_camera_is_not_drawn() -> None:
    image = rendering.cloud_image(np.array([[0.0, 0.0, -1.0]]), colours(RED), FRONT)
    assert np.all(image == rendering.BACKGROUND)


def test_a_surface_seen_from_behind_never_hides_one_seen_from_the_front() -> None:
    points = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 2.0], [2.0, 0.0, 1.0]])
    normals = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    image = rendering.cloud_image(points, colours(RED, GREEN, BLUE), FRONT, normals, radius=0)
    assert tuple(image[40, 50]) == GREEN
    assert image[40, 70, 2] == 255 and image[40, 70, 0] > 100  # alone, but faded


def test_a_view_from_above_looks_under_the_ceiling() -> None:
    rng = np.random.default_rng(0)
    floor, ceiling = rng.uniform(0, 4, (2, 4000, 3)) * (1.0, 0.75, 0.0) + [[[0.0]], [[2.6]]]
    points = np.concatenate([floor, ceiling])
    normals = np.repeat([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], 4000, axis=0)
    walls = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    view = rendering.top_view(points, np.concatenate([normals, walls]), UP, SIZE)
    shades = np.repeat(colours(GREEN, RED), 4000, axis=0)
    image = rendering.cloud_image(points, shades, view, radius=2)
    assert np.sum(np.all(image == GREEN, axis=-1)) > 0.6 * SIZE[0] * SIZE[1]
    assert not np.any(np.all(image == RED, axis=-1))


@given(st.floats(-3.0, 3.0))
def test_walls_lie_along_the_edges_seen_from_above(yaw: float) -> None:
    turn = se3.rotation_exp(np.array([0.0, 0.0, yaw]))
    points = np.random.default_rng(1).uniform(0, 1, (500, 3)) * (4, 3, 1) @ turn.T
    view = rendering.top_view(points, np.array([[1.0, 0, 0], [0, 1, 0]]) @ turn.T, UP, SIZE)
    wall = np.abs(view.camera_T_world[:2, :3] @ turn[:, 0])
    np.testing.assert_allclose(np.sort(wall), [0, 1], atol=1e-9)
    assert wall[0] > 0.5  # the longer wall along the longer edge


def test_a_slanted_view_shows_fronts_and_holds_the_cameras() -> None:
    points = np.random.default_rng(2).uniform(-1, 1, (500, 3)) * (1, 0, 1)
    normals = np.tile([0.0, -1.0, 0.0], (500, 1))
    marks = np.array([[0.0, -5.0, 1.5]])
    view = rendering.oblique_view(points, normals, UP, SIZE, marks)
    assert np.all(view.faces(normals))
    assert np.all(view.project(np.concatenate([points, marks]))[:, 2] > 0)
    x, y = view.project(marks)[0, :2]
    assert 0 <= x < SIZE[0] and 0 <= y < SIZE[1]
    top, bottom = view.project(np.array([[0.0, 0, 1], [0.0, 0, -1]]))[:, 1]
    assert top < bottom


def test_up_is_what_horizontal_surfaces_agree_on() -> None:
    rng = np.random.default_rng(3)
    flat = np.repeat([[0.0, 0, 1], [0, 0, -1], [1, 0, 0]], 200, axis=0)
    normals = flat + 0.05 * rng.normal(size=flat.shape)
    up = rendering.upright(normals, np.array([0.3, -0.2, 1.0]))
    assert np.degrees(np.arccos(up @ UP)) < 1.0


def test_points_of_a_frame_face_its_camera(scene: SyntheticScene) -> None:
    cloud = draw.frame_cloud(scene.frames[0], across=80)
    assert 1000 < len(cloud.points) <= 80 * 60
    assert np.all(np.einsum("ij,ij->i", cloud.points, cloud.normals) <= 0)
    np.testing.assert_allclose(np.linalg.norm(cloud.normals, axis=1), 1.0)


def test_panels_of_a_pair(scene: SyntheticScene, truth: list[Array]) -> None:
    pose = relative(truth[1], truth[0])
    away = se3.pose(np.eye(3), np.array([50.0, 0.0, 0.0])) @ pose
    poses = {"right": pose, "wrong": away, "none": None}
    row = draw.pair_row(scene.frames[1], scene.frames[0], poses, pose, size=SIZE)
    assert list(row) == ["scans", draw.TRUTH, "right", "wrong", "none"]
    assert {image.shape[0] for image in row.values()} == {SIZE[1] + page.CAPTION_PX}
    assert orange(row["right"]) > 200 and orange(row["wrong"]) == 0
    assert blue(row["right"]) > 200 and blue(row["wrong"]) > 200
    assert np.array_equal(row["none"], page.message("no answer", SIZE))
    again = draw.pair_row(scene.frames[1], scene.frames[0], poses, pose, size=SIZE)
    assert all(np.array_equal(row[name], again[name]) for name in row)


def orange(panel: rendering.Picture) -> int:
    red, _, blue = np.moveaxis(panel[: SIZE[1]].astype(int), -1, 0)
    return int(np.sum(red - blue > 60))


def blue(panel: rendering.Picture) -> int:
    red, _, blue = np.moveaxis(panel[: SIZE[1]].astype(int), -1, 0)
    return int(np.sum(blue - red > 40))


def test_panels_of_a_set_do_not_depend_on_the_world(
    scene: SyntheticScene, truth: list[Array]
) -> None:
    world = se3.exp(np.array([0.4, -1.0, 2.0, 3.0, 1.0, -2.0]))
    poses = {
        "moved": [world @ pose for pose in truth],
        "two": [truth[0], truth[1], None],
        "one": [truth[0], None, None],
    }
    row = draw.set_row(scene.frames, poses, truth, size=SIZE)
    assert list(row) == [draw.TRUTH, *poses]
    assert differing(row["moved"], row[draw.TRUTH]) < 0.02
    assert differing(row["two"], row[draw.TRUTH]) > 0.02
    assert np.array_equal(row["one"], page.message("no answer", SIZE, "3 unplaced"))


def differing(a: rendering.Picture, b: rendering.Picture) -> float:
    gap = np.abs(a[: SIZE[1]].astype(int) - b[: SIZE[1]].astype(int))
    return float(np.mean(np.max(gap, axis=-1) > 40))


def test_captions_count_what_is_right_and_unplaced(truth: list[Array]) -> None:
    bent = truth[1] @ se3.exp(np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0]))
    assert (
        draw.set_caption(np.stack(truth), [truth[0], None, truth[2]]) == "2 of 3 right, 1 unplaced"
    )
    assert draw.pair_caption(truth[1], bent)[0] == "✗ 57.3°, 0.00 m"
    assert draw.pair_caption(truth[1], truth[1])[0] == "✓ 0.0°, 0.00 m"


def test_a_grid_puts_every_picture_in_its_cell(tmp_path: Path) -> None:
    def plain(colour: tuple[int, int, int], width: int) -> rendering.Picture:
        return np.full((40, width, 3), colour, np.uint8)

    images = [[plain(RED, 30), plain(GREEN, 60)], [plain(BLUE, 30)]]
    whole = page.grid(images, ["a", "b"], ["first", "second\nrow"])
    places = {c: np.argwhere(np.all(whole == c, axis=-1)).min(axis=0) for c in (RED, GREEN, BLUE)}
    assert [np.sum(np.all(whole == c, axis=-1)) for c in places] == [1200, 2400, 1200]
    assert places[RED][0] == places[GREEN][0] < places[BLUE][0]
    assert places[RED][1] == places[BLUE][1] < places[GREEN][1]
    assert np.all(whole[-1, -1] == 255)
    for name in ("one.png", "two.png"):
        page.save_png(whole, tmp_path / "new" / name)
    assert same_bytes(tmp_path / "new" / "one.png", tmp_path / "new" / "two.png")
    assert np.array_equal(
        np.asarray(Image.open(tmp_path / "new" / "one.png").convert("RGB")), whole
    )


def same_bytes(a: Path, b: Path) -> bool:
    return a.read_bytes() == b.read_bytes()


def test_recall_counts_failures_as_never() -> None:
    x, share = curves.recall_curve([3.0, math.inf, 1.0, math.nan, 20.0], 10.0)
    assert x.tolist() == [0.0, 1.0, 3.0, 10.0]
    assert share.tolist() == [0.0, 0.2, 0.4, 0.4]
    assert curves.recall_curve([], 10.0)[1].tolist() == [0.0, 0.0]


@given(st.lists(st.floats(0.0, 180.0) | st.just(math.nan), min_size=1), st.floats(1.0, 180.0))
def test_recall_is_the_share_within(errors: list[float], limit: float) -> None:
    x, share = curves.recall_curve(errors, limit)
    assert x[0] == 0.0 and x[-1] == limit
    for at, value in zip(x, share, strict=True):
        assert value == pytest.approx(sum(error <= at for error in errors) / len(errors))


def test_wilson_interval() -> None:
    assert curves.wilson(0.5, 100) == pytest.approx((0.4038, 0.5962), abs=1e-4)
    low, high = curves.wilson(0.0, 10)
    assert low == pytest.approx(0.0, abs=1e-12) and high == pytest.approx(0.2775, abs=1e-4)


def test_figures_have_the_same_bytes_twice(tmp_path: Path) -> None:
    errors = {"a": [1.0, 5.0, math.inf], "b": [0.2, 40.0, 9.0]}
    bins = {"a": reliability(np.array([0.1, 0.9, 0.95]), np.array([False, True, False]))}
    for run in (tmp_path / "1", tmp_path / "2"):
        curves.error_recall(errors, "degrees", 30.0, run / "recall.png", right=15.0)
        curves.pose_recall(errors, errors, run / "pose.png")
        curves.reliability_diagram(bins, run / "reliability.png")
    for name in ("recall.png", "pose.png", "reliability.png"):
        assert same_bytes(tmp_path / "1" / name, tmp_path / "2" / name)
        with Image.open(tmp_path / "1" / name) as image:
            assert "Software" not in image.info
            assert np.asarray(image.convert("L")).std() > 5
