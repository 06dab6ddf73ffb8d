"""The aligner: correlations over yaws and shifts, and the poses that it answers with."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from fewview.alignment import (
    AlignerNetwork,
    AlignerNetworkConfig,
    Alignment,
    Embedded,
    joint_drawing,
    pose_of,
)
from fewview.alignment.align import NEVER
from fewview.alignment.drawing import CHANNELS, OBSERVED, PREDICTED, Drawing
from fewview.alignment.network import GRID, SHIFTS, STEP_M, YAWS, Spectra, shifts, spectrum
from fewview.completion.layout.grid import CELL_M, CELLS
from fewview.geometry import se3

EMPTY = Drawing(np.zeros((CHANNELS, CELLS, CELLS), np.float32), np.eye(4), -1.4)


@pytest.fixture(scope="module")
def network() -> AlignerNetwork:
    torch.manual_seed(0)
    return AlignerNetwork(AlignerNetworkConfig(width=8, channels=2)).eval()


def embedded(spot: tuple[int, int]) -> Embedded:
    """An embedding that is one at a cell and zero elsewhere, the same for every yaw."""
    maps = torch.zeros(1, YAWS, 1, GRID, GRID)
    maps[..., spot[0], spot[1]] = 100.0
    turned = torch.stack([torch.rot90(maps[:, k], k, (2, 3)) for k in range(YAWS)], dim=1)
    return Embedded(EMPTY, Spectra(spectrum(turned), spectrum(maps[:, 0])))


def drawing(seed: int, seen: slice = slice(None)) -> Drawing:
    """Noise that was observed in some rows of the grid."""
    channels = np.random.default_rng(seed).random((CHANNELS, CELLS, CELLS)).astype(np.float32)
    channels[OBSERVED] = 0.0
    channels[OBSERVED, seen] = 1.0
    return Drawing(channels, np.eye(4), -1.4)


def test_a_scan_drawn_together_with_itself_stays_as_it_is() -> None:
    alone = drawing(0)
    joint = joint_drawing(alone, [alone], np.eye(4)[None])
    np.testing.assert_allclose(joint.channels, alone.channels, atol=1e-6)


def test_what_only_one_scan_observed_is_taken_from_it() -> None:
    first, second = drawing(0, slice(0, 20)), drawing(1, slice(20, 40))
    joint = joint_drawing(first, [second], np.eye(4)[None]).channels
    np.testing.assert_allclose(joint[PREDICTED, :20], first.channels[PREDICTED, :20], atol=1e-6)
    np.testing.assert_allclose(
        joint[PREDICTED, 20:40], second.channels[PREDICTED, 20:40], atol=1e-6
    )
    both = 0.5 * (first.channels + second.channels)
    np.testing.assert_allclose(joint[PREDICTED, 40:], both[PREDICTED, 40:], atol=1e-6)
    assert joint[OBSERVED, :40].all() and not joint[OBSERVED, 40:].any()


def test_another_scan_is_moved_before_it_is_drawn() -> None:
    turned = se3.pose(se3.rotation_exp(np.array([0.0, 0.0, np.pi / 2])), np.array([0.5, 0.0, 0.0]))
    nothing, other = drawing(0, slice(0, 0)), drawing(1)
    joint = joint_drawing(nothing, [other], turned[None]).channels
    steps = round(0.5 / CELL_M)
    expected = np.roll(np.rot90(other.channels[PREDICTED], 1, (1, 2)), -steps, axis=1)
    np.testing.assert_allclose(joint[PREDICTED, :-steps], expected[:, :-steps], atol=1e-6)


def test_shifts_count_back_beyond_half() -> None:
    at = shifts()
    assert float(at[1]) == -STEP_M
    assert float(at[-1]) == STEP_M


def test_the_logit_of_a_shift_is_the_sum_of_products(network: AlignerNetwork) -> None:
    maps = torch.randn(2, 3, GRID, GRID)
    size = (SHIFTS, SHIFTS)
    source = torch.fft.rfft2(maps[:1, None].expand(-1, YAWS, -1, -1, -1), size)
    logits = network.logits(source, torch.fft.rfft2(maps[1:], size)) / network.log_scale.exp()
    by_hand = (maps[0, :, :-2, 5:] * maps[1, :, 2:, :-5]).sum()
    torch.testing.assert_close(logits[0, 0, 0, 2, SHIFTS - 5], by_hand, rtol=1e-3, atol=1e-2)


def test_a_spectrum_and_its_gradient_are_those_of_torch() -> None:
    planes = torch.randn(2, 3, GRID, GRID, generator=torch.Generator().manual_seed(0))
    found, expected = (planes.clone().requires_grad_() for _ in range(2))
    ours, theirs = spectrum(found), torch.fft.rfft2(expected, (SHIFTS, SHIFTS))
    torch.testing.assert_close(ours, theirs)
    way = torch.randn(*ours.shape, dtype=ours.dtype, generator=torch.Generator().manual_seed(1))
    for transform in (ours, theirs):
        (transform * way).real.sum().backward()
    torch.testing.assert_close(found.grad, expected.grad, rtol=1e-4, atol=1e-3)


def test_the_best_pose_lays_the_spots_over_each_other(network: AlignerNetwork) -> None:
    source, target = embedded((10, 12)), embedded((14, 9))
    poses = Alignment(source, target, network).best(8)
    assert (np.diff(poses.log_mass) <= 1e-6).all()
    turn, shift = se3.distance(
        poses.target_T_source[:YAWS], pose_of(EMPTY, EMPTY, 0.0, -STEP_M * np.array([4, -3]))
    )
    assert (turn < 1e-6).sum() == 1
    assert shift[turn < 1e-6][0] < 0.3 * STEP_M


def test_the_probability_around_a_proposed_pose_is_its_own(network: AlignerNetwork) -> None:
    alignment = Alignment(embedded((10, 12)), embedded((14, 9)), network)
    poses = alignment.best(4)
    np.testing.assert_allclose(alignment.log_mass(poses.target_T_source), poses.log_mass, atol=0.3)
    assert alignment.mass.sum() == pytest.approx(9.0, abs=0.01)
    yaws = [pose_of(EMPTY, EMPTY, k * np.pi / 2, np.zeros(2)) for k in range(YAWS)]
    assert np.exp(alignment.log_yaw(np.stack(yaws))).sum() == pytest.approx(1.0, abs=1e-3)


def test_a_pose_near_the_best_settles_there_and_one_far_away_stays(
    network: AlignerNetwork,
) -> None:
    alignment = Alignment(embedded((10, 12)), embedded((14, 9)), network)
    best = pose_of(EMPTY, EMPTY, 0.0, -STEP_M * np.array([4, -3]))
    askew = best @ se3.exp(np.array([0.1, -0.05, 0.3, 0.15, -0.2, 0.0]))
    beyond = pose_of(EMPTY, EMPTY, np.pi / 2, np.array([9.0, 0.0]))
    turn, shift = se3.distance(alignment.near(np.stack([askew, beyond]), 0.3), best)
    assert turn[0] < 1e-6 and shift[0] < 0.5 * STEP_M
    np.testing.assert_allclose(alignment.near(beyond[None], 0.3)[0], beyond, atol=STEP_M / 2)


def test_poses_out_of_reach_and_oblique_ones_are_impossible(network: AlignerNetwork) -> None:
    alignment = Alignment(embedded((10, 12)), embedded((14, 9)), network)
    far = pose_of(EMPTY, EMPTY, 0.0, np.array([9.0, 0.0]))
    oblique = pose_of(EMPTY, EMPTY, 0.6, np.zeros(2))
    np.testing.assert_array_equal(alignment.log_mass(np.stack([far, oblique])), NEVER)


def test_embeddings_of_drawings(network: AlignerNetwork) -> None:
    spectra = network(torch.rand(2, CHANNELS, CELLS, CELLS))
    assert spectra.source.shape == (2, YAWS, 2, SHIFTS, SHIFTS // 2 + 1)
    every = network.logits(spectra.source, spectra.target[:1])
    assert every.shape == (2, 1, YAWS, SHIFTS, SHIFTS)
    one = network.logits(spectra.source[1:], spectra.target[:1])
    torch.testing.assert_close(every[1:], one)
