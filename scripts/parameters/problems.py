"""What l_3 and l_4 look at in a pair of scans."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.spatial import cKDTree

from fewview.config import RefinementConfig
from fewview.evaluation.relations import perturbed
from fewview.matching.spectral import INLIER_SCALE, agreeing
from fewview.refinement import regression
from fewview.refinement.relations import RelationPredictor
from fewview.training.consistency import SpectralProblem
from fewview.training.regression_energy import FeaturePairs, RegressionProblem
from fewview.types import Array, CompletedScan, Surface
from parameters.pairs import Part, ScannedRoom, ScanPair

MIN_RIGHT = 5
"""Pairs with fewer right correspondences teach nothing about gammas."""
Searchable = tuple[Surface, cKDTree]


def spectral_problems(
    rooms: Iterable[ScannedRoom], part: Part, scale: float
) -> list[SpectralProblem]:
    """One for each pair in which enough correspondences of a part are right.

    Args:
        rooms: with their pairs.
        part: which pass.
        scale: how far, in shipped length scales, the true pose may leave a right correspondence
            unexplained. Not the learned scales: what is right must not depend on what is learned.
    """
    found = []
    for room in rooms:
        for pair in room.pairs:
            matches = pair.candidates(part)
            right = agreeing(matches, pair.target_T_source, scale)
            if right.sum() >= MIN_RIGHT:
                found.append(SpectralProblem.of(matches, right))
    return found


def regression_problems(
    rooms: Iterable[ScannedRoom],
    predictor: RelationPredictor,
    config: RefinementConfig,
    farthest: tuple[float, float],
    rng: np.random.Generator,
) -> list[RegressionProblem]:
    """One for each pair.

    Args:
        rooms: with their pairs.
        predictor: of relations under the start.
        config: its last radius finds neighbours at the truth, its first one away from it.
        farthest: degrees and metres by which starts are off the truth at most; 0, 0: the paper's.
        rng: draws the starts.
    """
    radius = config.neighbour_m[0 if any(farthest) else -1]
    found = []
    for room in rooms:
        scans = [searchable(scan) for scan in room.scans]
        for pair in room.pairs:
            truth = pair.target_T_source
            start = perturbed(truth, rng, *farthest)
            i, j = pair.source, pair.target
            near = regression.neighbours(scans[i], scans[j], start[None], radius)
            pairs = FeaturePairs.of(
                near.source[0],
                near.source_normals[0],
                near.target[0],
                near.target_normals[0],
                near.weight[0],
            )
            relations = predictor.predict(room.scans[i], room.scans[j], start[None])
            held = anchors(pair, start[None])
            found.append(RegressionProblem.of(start, truth, pairs, relations, held))
    return found


def searchable(scan: CompletedScan) -> Searchable:
    """A scan's surface with the k-d tree of its points."""
    return scan.surface, cKDTree(scan.surface.points)


def anchors(pair: ScanPair, poses: Array) -> regression.Matches:
    """Matched features that hold (K, 4, 4) poses: seen ones that are exact points and agree."""
    matches = pair.observed
    fixed = matches.scale("fixed_point") > 0
    agree = np.array([agreeing(matches, pose, INLIER_SCALE) & fixed for pose in poses])
    return regression.Matches(matches.source, matches.target, agree.astype(np.float64))


def refined(
    room: ScannedRoom,
    pair: ScanPair,
    poses: Array,
    predictor: RelationPredictor,
    config: RefinementConfig,
) -> Array:
    """(K, 4, 4) poses after the local module."""
    source, target = room.scans[pair.source], room.scans[pair.target]
    return regression.refine(
        searchable(source),
        searchable(target),
        poses,
        predictor.predict(source, target, poses),
        anchors(pair, poses),
        config,
    ).target_T_source
