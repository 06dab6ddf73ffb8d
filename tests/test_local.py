"""The local module by itself: poses from far off, scans without completion, nothing in common."""

from __future__ import annotations

import numpy as np
import pytest

from fewview import synthetic
from fewview.completion import OBSERVED_KINDS, complete
from fewview.config import FeatureConfig, RefinementConfig
from fewview.evaluation.metrics import rotation_error_deg, translation_error_m
from fewview.evaluation.relations import perturbed
from fewview.geometry import se3
from fewview.matching.prepared import PreparedScan, prepare
from fewview.refinement.local import refine_alone, refine_related
from fewview.refinement.regression import Matches
from fewview.types import Array

SEEN = FeatureConfig(kinds=tuple(kind.name for kind in OBSERVED_KINDS))


@pytest.fixture(scope="module")
def scene() -> synthetic.SyntheticScene:
    return synthetic.generate(synthetic.split_seed("test", 7), 3, seed=1, mode="spread")


@pytest.fixture(scope="module")
def scans(scene: synthetic.SyntheticScene) -> list[PreparedScan]:
    config = FeatureConfig()
    frames = zip(scene.names, scene.frames, strict=True)
    return [prepare(complete(name, frame, 0, config, 0)) for name, frame in frames]


def truth(scene: synthetic.SyntheticScene, source: int, target: int) -> Array:
    a, b = (scene.poses[scene.names[i]] for i in (source, target))
    return np.asarray(se3.inverse(b) @ a)


def test_poses_are_brought_back_from_far_off(
    scene: synthetic.SyntheticScene, scans: list[PreparedScan]
) -> None:
    rng = np.random.default_rng(0)
    before, after = [], []
    for i, j in ((0, 1), (1, 2), (0, 2)):
        target_T_source = truth(scene, i, j)
        starts = np.stack([perturbed(target_T_source, rng) for _ in range(4)])
        found = refine_alone(scans[i], scans[j], starts, RefinementConfig())
        for errors, poses in ((before, starts), (after, found)):
            turns = rotation_error_deg(target_T_source, poses)
            errors.append(np.stack([turns, translation_error_m(target_T_source, poses)]))
    (turn, shift), (refined_turn, refined_shift) = (np.concatenate(e, 1) for e in (before, after))
    assert np.median(refined_turn) < 0.25 * np.median(turn)
    assert np.median(refined_shift) < np.median(shift)


def test_a_scan_finds_itself_again(scans: list[PreparedScan]) -> None:
    rng = np.random.default_rng(1)
    starts = np.stack([perturbed(np.eye(4), rng, 25.0, 0.3) for _ in range(4)])
    found = refine_alone(scans[0], scans[0], starts, RefinementConfig())
    assert (rotation_error_deg(np.eye(4), found) < 0.5).all()
    assert (translation_error_m(np.eye(4), found) < 0.02).all()


def test_scans_without_completion_are_refined_too(scene: synthetic.SyntheticScene) -> None:
    scan = prepare(complete("a", scene.frames[0], 0, SEEN, 0))
    assert not scan.scan.room.completed
    start = perturbed(np.eye(4), np.random.default_rng(2), 5.0, 0.05)[None]
    found = refine_alone(scan, scan, start, RefinementConfig())
    assert rotation_error_deg(np.eye(4), found)[0] < 0.5


def test_no_poses_are_no_poses(scans: list[PreparedScan]) -> None:
    nothing = np.zeros((0, 4, 4))
    assert refine_alone(scans[0], scans[1], nothing, RefinementConfig()).shape == (0, 4, 4)
    matches = Matches(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 0)))
    refined = refine_related(scans[0], scans[1], nothing, matches, RefinementConfig())
    assert refined.hessian.shape == refined.covariance.shape == (0, 6, 6)
