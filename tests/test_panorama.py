"""The ring and the 360-image completion network."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from box_rooms import box_room
from hypothesis import given
from hypothesis import strategies as st

from fewview import weights
from fewview.completion.panorama import (
    CLASSES,
    PanoramaNetwork,
    PanoramaNetworkConfig,
    complete_ring,
    heading_frame,
    network_input,
    project_scan,
    ring_normals,
    ring_pixels,
    ring_points,
)
from fewview.completion.panorama.walls import scan_ring, wall_azimuth
from fewview.errors import FewviewError
from fewview.geometry import se3
from fewview.training.panorama import along_walls
from fewview.types import Intrinsics, RingScan

SIZE = 64
TINY = PanoramaNetworkConfig(width=16, descriptor=8)


@pytest.fixture(scope="module")
def network() -> PanoramaNetwork:
    torch.manual_seed(0)
    return PanoramaNetwork(TINY).eval()


def turned(ring: np.ndarray, faces: int) -> np.ndarray:
    return np.ascontiguousarray(np.roll(ring, faces * SIZE, axis=1))


@given(st.floats(-180, 180), st.floats(-40, 40), st.floats(0.5, 8.0))
def test_a_point_comes_back_from_the_pixel_that_shows_it(
    azimuth: float, elevation: float, distance: float
) -> None:
    a, e = np.radians(azimuth), np.radians(elevation)
    point = distance * np.array([np.cos(a), np.sin(a), np.tan(e)])
    pixel, depth, inside = ring_pixels(point, SIZE)
    if not inside:
        assert abs(point[2]) > 0.7 * distance
        return
    image = np.zeros((SIZE, 4 * SIZE), np.float32)
    image.ravel()[pixel] = depth
    back = ring_points(image).reshape(-1, 3)[pixel]
    assert np.linalg.norm(back - point) < 1.5 * depth / (SIZE / 2)


def test_left_of_the_heading_is_left_in_the_ring() -> None:
    points = np.array([[0.0, 2, 0], [2, 0, 0], [0, -2, 0], [-2, 0.1, 0]])
    pixel, depth, inside = ring_pixels(points, SIZE)
    assert inside.all()
    np.testing.assert_allclose(depth, 2.0)
    np.testing.assert_array_equal(pixel % (4 * SIZE) // SIZE, [0, 1, 2, 3])


def test_a_scan_straight_ahead_fills_the_middle_of_the_front_face() -> None:
    camera = Intrinsics(320, 240, 290.0, 290.0, 159.5, 119.5)
    level_T_scan = heading_frame(np.array([0.0, -1.0, 0.0]))
    colour = np.full((240, 320, 3), (10, 20, 30), np.uint8)
    ring = project_scan(np.full((240, 320), 2.5, np.float32), colour, camera, level_T_scan, SIZE)
    seen = ring.depth > 0
    columns = np.flatnonzero(seen.any(axis=0))
    assert SIZE < columns.min() < columns.max() < 2 * SIZE
    assert columns.min() + columns.max() == 3 * SIZE - 1
    assert seen[SIZE // 2, columns.min() : columns.max() + 1].all()
    np.testing.assert_allclose(ring.depth[seen], 2.5, rtol=1e-5)
    assert (ring.colour[seen] == (10, 20, 30)).all()


def test_the_nearest_surface_wins_and_is_averaged() -> None:
    camera = Intrinsics(3, 1, 1000.0, 1000.0, 1.0, 0.0)
    depth = np.array([[2.0, 2.02, 4.0]], np.float32)
    colour = np.array([[[0, 0, 0], [100, 0, 0], [255, 255, 255]]], np.uint8)
    level_T_scan = se3.pose(
        se3.rotation_exp(np.radians([0.0, 0.0, 0.3])), np.zeros(3)
    ) @ heading_frame(np.array([0.0, -1.0, 0.0]))
    ring = project_scan(depth, colour, camera, level_T_scan, SIZE)
    (found,) = ring.depth[ring.depth > 0]
    assert found == pytest.approx(2.01, abs=1e-3)
    assert tuple(ring.colour[ring.depth > 0][0]) == (50, 0, 0)


@pytest.mark.parametrize("pitch", [-60.0, -20.0, 0.0, 35.0])
def test_the_heading_is_level_and_x(pitch: float) -> None:
    p = np.radians(pitch)
    level_T_scan = heading_frame(np.array([0.0, -np.cos(p), -np.sin(p)]))
    forward = level_T_scan[:3, 2]
    assert forward[0] > 0 and abs(forward[1]) < 1e-12
    assert np.degrees(np.arcsin(forward[2])) == pytest.approx(-pitch)
    assert np.linalg.det(level_T_scan[:3, :3]) == pytest.approx(1.0)


def test_normals_of_a_ring_are_those_of_the_room() -> None:
    room = box_room(3, views=2, size=SIZE)
    found = ring_normals(torch.from_numpy(room.depth)).permute(0, 2, 3, 1).numpy()
    cosine = (found * room.normal).sum(axis=-1)
    assert np.mean(cosine > 0.99) > 0.95
    partly = ring_normals(torch.from_numpy(room.measured)).numpy()
    assert not partly.transpose(0, 2, 3, 1)[room.measured == 0].any()


def test_a_ring_along_the_walls_has_axes_for_normals() -> None:
    room = along_walls(box_room(4, views=3, size=SIZE))
    upright = np.abs(room.normal[..., 2]) < 0.5
    facing = np.abs(room.normal[upright]).max(axis=-1)
    known = facing > 0
    assert known.mean() > 0.8
    assert np.mean(facing[known] > 0.999) > 0.99
    for depth, pose in zip(room.depth, room.level_T_world, strict=True):
        world = se3.transform(se3.inverse(pose), ring_points(depth)[depth > 0].astype(float))
        floor = np.abs(world[:, 2]) < 0.05
        assert 0.1 < floor.mean() < 0.5
        assert world[:, 2].min() > -0.1


@pytest.mark.parametrize("azimuth", [-40.0, -3.0, 0.0, 25.0])
def test_the_azimuth_of_walls_is_found_among_clutter(azimuth: float) -> None:
    rng = np.random.default_rng(0)
    angles = np.radians(azimuth + 90.0 * rng.integers(4, size=300) + 2.0 * rng.standard_normal(300))
    clutter = rng.uniform(-np.pi, np.pi, 150)
    both = np.concatenate([angles, clutter])
    normals = np.stack([np.cos(both), np.sin(both), 0 * both], axis=-1).astype(np.float32)
    assert np.degrees(wall_azimuth(normals)) == pytest.approx(azimuth, abs=1.0)
    assert wall_azimuth(normals[:10]) == 0.0
    assert wall_azimuth(np.zeros((50, 3), np.float32)) == 0.0


def test_a_scan_of_a_slanted_wall_gets_a_ring_along_it() -> None:
    camera = Intrinsics(160, 120, 145.0, 145.0, 79.5, 59.5)
    columns = (np.arange(160) - 79.5) / 145.0
    slope = np.tan(np.radians(20.0))
    depth = np.tile((2.0 / (1.0 - slope * columns)).astype(np.float32), (120, 1))
    colour = np.full((120, 160, 3), 90, np.uint8)
    ring = scan_ring(depth, colour, camera, np.array([0.0, -1.0, 0.0]), SIZE)
    ahead = ring.depth[:, SIZE : 2 * SIZE]
    seen = ahead[ahead > 0]
    assert len(seen) > 500
    np.testing.assert_allclose(
        np.percentile(seen, [1, 99]), 2.0 * np.cos(np.radians(20)), rtol=0.01
    )


def test_shapes_and_units(network: PanoramaNetwork) -> None:
    room = box_room(0, views=2, size=SIZE)
    inputs = network_input(torch.from_numpy(room.colour), torch.from_numpy(room.measured))
    assert inputs.shape == (2, 10, SIZE, 4 * SIZE)
    answer = network(inputs)
    assert answer.log_depth.shape == answer.log_scale.shape == (2, SIZE, 4 * SIZE)
    assert answer.normal.shape == (2, 3, SIZE, 4 * SIZE)
    assert answer.semantics.shape == (2, len(CLASSES), SIZE // 2, 2 * SIZE)
    assert answer.descriptor.shape == (2, TINY.descriptor, SIZE // 2, 2 * SIZE)
    np.testing.assert_allclose(answer.normal.detach().norm(dim=1), 1.0, atol=1e-5)


@pytest.mark.parametrize("faces", [1, 3])
def test_turning_the_ring_by_a_face_turns_the_answer(network: PanoramaNetwork, faces: int) -> None:
    """Depth and meaning; normals are directions, so that theirs would turn as well."""
    room = box_room(1, views=1, size=SIZE)
    inputs = network_input(torch.from_numpy(room.colour), torch.from_numpy(room.measured))
    with torch.inference_mode():
        straight, rolled = network(inputs), network(inputs.roll(faces * SIZE, dims=-1))
    for name, scale in (("log_depth", 1), ("log_scale", 1), ("semantics", 2), ("descriptor", 2)):
        expected = getattr(straight, name).roll(faces * SIZE // scale, dims=-1)
        torch.testing.assert_close(getattr(rolled, name), expected, rtol=1e-3, atol=1e-4)
    assert not torch.allclose(rolled.log_depth, straight.log_depth, atol=1e-3)


def test_an_answer_does_not_depend_on_the_rest_of_the_batch(network: PanoramaNetwork) -> None:
    room = box_room(2, views=2, size=SIZE)
    inputs = network_input(torch.from_numpy(room.colour), torch.from_numpy(room.measured))
    with torch.inference_mode():
        alone, together = network(inputs[:1]), network(inputs)
    torch.testing.assert_close(alone.log_depth, together.log_depth[:1], rtol=1e-4, atol=1e-5)


def test_what_was_measured_stays_as_it_was(network: PanoramaNetwork) -> None:
    room = box_room(5, views=1, size=SIZE)
    ring = RingScan(room.colour[0], room.measured[0], np.eye(4))
    completed = complete_ring(ring, network)
    seen = ring.depth > 0
    np.testing.assert_array_equal(completed.observed, seen)
    np.testing.assert_array_equal(completed.depth[seen], ring.depth[seen])
    cosine = (completed.normals * room.normal[0]).sum(axis=-1)
    assert np.mean(cosine[seen] > 0.99) > 0.9
    assert (completed.depth > 0).all()
    np.testing.assert_allclose(np.linalg.norm(completed.descriptors, axis=-1), 1.0, atol=1e-5)
    np.testing.assert_allclose(completed.semantics.sum(axis=-1), 1.0, atol=1e-5)
    assert completed.semantics.shape == (SIZE, 4 * SIZE, len(CLASSES))
    assert (completed.confidence[seen] == 1).all()
    assert ((completed.confidence > 0) & (completed.confidence <= 1)).all()


def test_a_scan_that_shows_nothing_is_completed_too(network: PanoramaNetwork) -> None:
    empty = np.zeros((SIZE, 4 * SIZE), np.float32)
    completed = complete_ring(
        RingScan(np.zeros((*empty.shape, 3), np.uint8), empty, np.eye(4)), network
    )
    assert np.isfinite(completed.depth).all() and not completed.observed.any()


def test_weights_come_back_with_their_card(network: PanoramaNetwork, tmp_path: Path) -> None:
    weights.save("panorama", tmp_path, network.state_dict(), {"steps": 3})
    state, card = weights.load("panorama", tmp_path)
    assert card["steps"] == 3
    for name, tensor in network.state_dict().items():
        assert torch.equal(tensor, state[name])


def spoil_data(folder: Path) -> None:
    data = bytearray((folder / "panorama.safetensors").read_bytes())
    data[-1] ^= 1
    (folder / "panorama.safetensors").write_bytes(data)


def spoil_card(folder: Path) -> None:
    (folder / "panorama.json").write_text("[]")


def remove_card(folder: Path) -> None:
    (folder / "panorama.json").unlink()


def no_tensors(folder: Path) -> None:
    import hashlib

    (folder / "panorama.safetensors").write_bytes(b"nothing")
    card = {"sha256": hashlib.sha256(b"nothing").hexdigest()}
    (folder / "panorama.json").write_text(json.dumps(card))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (spoil_data, "is not what panorama.json describes"),
        (spoil_card, "is not a card of weights"),
        (remove_card, "no such weights"),
        (no_tensors, "is damaged"),
    ],
)
def test_wrong_weights_are_refused(
    network: PanoramaNetwork, tmp_path: Path, spoil: object, message: str
) -> None:
    weights.save("panorama", tmp_path, network.state_dict(), {})
    assert callable(spoil)
    spoil(tmp_path)
    with pytest.raises(FewviewError, match=message):
        weights.load("panorama", tmp_path)
