"""Predictors of relations: what each knows, and what judging them counts."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from benchmark.relation_runs import CEILING, Judged, Labelled, judge
from benchmark.relations import LABEL_RULES, PREDICTORS, Predictor, Rules, planar_patches
from benchmark.surface_truth import Oriented, TrueMesh
from fewview.completion import complete
from fewview.config import FeatureConfig
from fewview.evaluation.relations import Relation, accuracies, true_relations
from fewview.geometry import se3
from fewview.synthetic import SyntheticScene, generate, split_seed
from fewview.types import Array, CompletedScan, IntArray


@pytest.fixture(scope="module")
def room() -> SyntheticScene:
    return generate(split_seed("validation", 3), 2, width=320, height=240)


@pytest.fixture(scope="module")
def scans(room: SyntheticScene) -> tuple[CompletedScan, CompletedScan]:
    source, target = (
        complete(name, frame, 0, FeatureConfig(), 0)
        for name, frame in zip(room.names, room.frames, strict=True)
    )
    return source, target


@pytest.fixture(scope="module")
def labelled(
    room: SyntheticScene, scans: tuple[CompletedScan, CompletedScan]
) -> tuple[Labelled, Labelled]:
    mesh = TrueMesh(room.mesh)
    source, target = (Labelled(s, mesh.behind(s, room.poses[s.name])) for s in scans)
    return source, target


def true_pose(room: SyntheticScene) -> Array:
    source, target = room.names
    return np.asarray(se3.inverse(room.poses[target]) @ room.poses[source])


def judged(room: SyntheticScene, pair: tuple[Labelled, Labelled], seed: int = 0) -> Judged:
    return judge(*pair, true_pose(room), np.random.default_rng(seed), PREDICTORS, samples=2000)


def some_points(scans: tuple[CompletedScan, CompletedScan]) -> tuple[IntArray, IntArray]:
    rng = np.random.default_rng(1)
    i, j = (rng.integers(len(s.surface.points), size=3000) for s in scans)
    return i, j


def test_the_mesh_is_close_to_what_was_measured(labelled: tuple[Labelled, Labelled]) -> None:
    for one in labelled:
        seen = one.scan.surface
        assert np.median(np.linalg.norm(one.truth.points - seen.points, axis=1)) < 0.01
        cosine = np.einsum("ni,ni->n", one.truth.normals, seen.normals)
        assert np.degrees(np.arccos(np.median(cosine))) < 8.0
        np.testing.assert_allclose(np.linalg.norm(one.truth.normals, axis=1), 1.0)
        assert np.all(np.einsum("ni,ni->n", one.truth.normals, one.truth.points) <= 1e-6)


def test_rules_are_right_where_pose_and_normals_are(
    room: SyntheticScene, scans: tuple[CompletedScan, CompletedScan]
) -> None:
    i, j = some_points(scans)
    a, b, pose = Oriented.of(scans[0]).at(i), Oriented.of(scans[1]).at(j), true_pose(room)
    labels = true_relations(a.points, a.normals, b.points, b.normals, pose)
    np.testing.assert_array_equal(LABEL_RULES(*scans, pose, i, j), labels)
    assert not np.array_equal(Rules(30.0, 1.0)(*scans, pose, i, j), labels)


def test_points_off_the_patches_have_no_relation(
    room: SyntheticScene, scans: tuple[CompletedScan, CompletedScan]
) -> None:
    i, j = some_points(scans)
    said = planar_patches(*scans, true_pose(room), i, j)
    off = (scans[0].surface.labels[i] < 0) | (scans[1].surface.labels[j] < 0)
    assert off.any() and (said[off] == Relation.NONE).all()
    assert set(said[~off].tolist()) >= {Relation.PARALLEL, Relation.PERPENDICULAR}


def test_patches_answer_as_their_normals_do(
    room: SyntheticScene, scans: tuple[CompletedScan, CompletedScan]
) -> None:
    """Each point is told the relation of its own patch, not of another pair of patches."""
    i, j = some_points(scans)
    said = planar_patches(*scans, true_pose(room), i, j)
    normals = [
        np.array([patch.normal for patch in s.patches])[s.surface.labels[index]]
        for s, index in zip(scans, (i, j), strict=True)
    ]
    cosine = np.abs(np.einsum("ni,ni->n", se3.rotate(true_pose(room), normals[0]), normals[1]))
    assert cosine[said == Relation.PERPENDICULAR].max() < np.cos(np.radians(70.0))
    assert cosine[np.isin(said, [Relation.COPLANAR, Relation.PARALLEL])].min() > 0.9


def test_a_scan_without_patches_is_answered(
    room: SyntheticScene, scans: tuple[CompletedScan, CompletedScan]
) -> None:
    source, target = scans
    bare = dataclasses.replace(
        source,
        patches=(),
        surface=dataclasses.replace(source.surface, labels=np.full_like(source.surface.labels, -1)),
    )
    i, j = some_points(scans)
    assert not planar_patches(bare, target, true_pose(room), i, j).any()


def test_every_predictor_judges_the_same_pairs(
    room: SyntheticScene, labelled: tuple[Labelled, Labelled]
) -> None:
    found = judged(room, labelled)
    rows = {name: counts.sum(axis=1).tolist() for name, counts in found.counts.items()}
    assert set(rows) == {*PREDICTORS, CEILING}
    assert all(row == rows[CEILING] for row in rows.values())
    assert sum(rows[CEILING]) == 2000
    assert 0.0 < found.perturbation_deg < 30.0


def test_judging_is_repeatable(room: SyntheticScene, labelled: tuple[Labelled, Labelled]) -> None:
    first, again, other = (judged(room, labelled, seed) for seed in (0, 0, 1))
    for name in first.counts:
        np.testing.assert_array_equal(first.counts[name], again.counts[name])
    assert first.perturbation_deg == again.perturbation_deg != other.perturbation_deg


def test_a_predictor_that_knows_the_truth_is_always_right(
    room: SyntheticScene, labelled: tuple[Labelled, Labelled]
) -> None:
    class Knows:
        def __call__(
            self,
            source: CompletedScan,
            target: CompletedScan,
            target_T_source: Array,
            source_index: IntArray,
            target_index: IntArray,
        ) -> IntArray:
            a, b = (
                one.truth.at(index)
                for one, index in zip(labelled, (source_index, target_index), strict=True)
            )
            return true_relations(a.points, a.normals, b.points, b.normals, true_pose(room))

    knows: dict[str, Predictor] = {"knows": Knows()}
    found = judge(*labelled, true_pose(room), np.random.default_rng(0), knows, samples=2000)
    right = accuracies(found.counts["knows"])
    np.testing.assert_allclose(right[~np.isnan(right)], 1.0)
    assert np.nanmin(accuracies(found.counts[CEILING])) < 1.0


def test_chance_says_every_class_as_often(
    room: SyntheticScene, labelled: tuple[Labelled, Labelled]
) -> None:
    counts = judged(room, labelled).counts["chance"]
    np.testing.assert_allclose(counts.sum(axis=0) / counts.sum(), 0.25, atol=0.05)
