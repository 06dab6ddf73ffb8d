"""Predictors of geometric relations between points of two scans, behind one signature (Sec. 3.3).

They are given a pose that is not quite right, as the local module is; see `relation_runs`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from benchmark.surface_truth import Oriented
from fewview.evaluation.relations import (
    MAX_ANGLE_DEG,
    MAX_OFFSET_M,
    Relation,
    read_relations,
)
from fewview.executor import single_threaded_libraries
from fewview.refinement.learned_relations import LearnedRelations
from fewview.refinement.relations import PatchRelations
from fewview.types import Array, CompletedScan, IntArray


class Predictor(Protocol):
    """Classifies point pairs of two scans under a pose that is not quite right."""

    def __call__(
        self,
        source: CompletedScan,
        target: CompletedScan,
        target_T_source: Array,
        source_index: IntArray,
        target_index: IntArray,
    ) -> IntArray:
        """(n,) `Relation` values of the surface points with these (n,) indices."""


@dataclass(frozen=True)
class Rules:
    """Believes the pose: reads relations off the points' own normals and positions."""

    max_angle_deg: float
    max_offset_m: float

    def __call__(
        self,
        source: CompletedScan,
        target: CompletedScan,
        target_T_source: Array,
        source_index: IntArray,
        target_index: IntArray,
    ) -> IntArray:
        a, b = Oriented.of(source).at(source_index), Oriented.of(target).at(target_index)
        return read_relations(
            a.points,
            a.normals,
            b.points,
            b.normals,
            target_T_source,
            self.max_angle_deg,
            self.max_offset_m,
        )


def planar_patches(
    source: CompletedScan,
    target: CompletedScan,
    target_T_source: Array,
    source_index: IntArray,
    target_index: IntArray,
) -> IntArray:
    """What `PatchRelations` says of the patches that the points lie on; none for other points.

    "None" is as probable as the three relations leave over; the most probable class is taken.
    """
    found = PatchRelations().predict(source, target, target_T_source[None])
    three = np.stack([found.coplanar[0], found.parallel[0], found.perpendicular[0]])
    best = np.concatenate([1.0 - three.sum(axis=0, keepdims=True), three]).argmax(axis=0)
    i, j = source.surface.labels[source_index], target.surface.labels[target_index]
    on_patches = (i >= 0) & (j >= 0)
    answer = np.full(len(i), Relation.NONE, dtype=np.int64)
    answer[on_patches] = best[i[on_patches] * len(target.patches) + j[on_patches]]
    return answer


def chance(
    source: CompletedScan,
    target: CompletedScan,
    target_T_source: Array,
    source_index: IntArray,
    target_index: IntArray,
) -> IntArray:
    """Each class as often as the others, whatever the points."""
    return np.random.default_rng(0).integers(len(Relation), size=len(source_index))


def relation_network(
    source: CompletedScan,
    target: CompletedScan,
    target_T_source: Array,
    source_index: IntArray,
    target_index: IntArray,
) -> IntArray:
    """The most probable class under the shipped relation network."""
    with single_threaded_libraries():
        chance = LearnedRelations().of_surface(
            source, target, target_T_source[None], source_index, target_index
        )
    return np.asarray(chance[0].argmax(axis=-1), dtype=np.int64)


LABEL_RULES = Rules(MAX_ANGLE_DEG, MAX_OFFSET_M)
"""The tolerances that make the labels."""
PREDICTORS: Mapping[str, Predictor] = {
    "chance": chance,
    "rules, 5 deg / 0.05 m": LABEL_RULES,
    "rules, 15 deg / 0.3 m": Rules(15.0, 0.3),
    "rules, 30 deg / 1 m": Rules(30.0, 1.0),
    "planar patches": planar_patches,
    "relation network": relation_network,
}
"""Row names and what is behind them.

The tolerances of the rules are those of the labels, of a right pose, and of the perturbation (on
validation rooms about the best mean accuracy that rules reach).
"""
