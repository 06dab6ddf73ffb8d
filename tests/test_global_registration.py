"""Registration of all scans of a component: a small box-shaped room seen from its middle."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from box_scans import SCANS, box, corridor, room, scan_of

from benchmark.planted_graphs import candidate, room_poses
from fewview.config import GlobalConfig
from fewview.geometry import se3
from fewview.global_stage import refine
from fewview.global_stage.clouds import HELD_OUT, Cloud
from fewview.global_stage.normal_equations import Facing, Link, gauss_newton_step
from fewview.global_stage.pose_graph import Edge
from fewview.global_stage.registration import Registered, judge, register
from fewview.types import (
    Array,
    CompletedScan,
    Component,
    GlobalSolution,
    PairResult,
    PairStatus,
    ScanPlacement,
)


def shaken(seed: int, poses: Array, angle_deg: float, distance_m: float) -> dict[int, Array]:
    """All poses but the first moved so far."""
    rng = np.random.default_rng(seed)
    xi = rng.normal(size=(len(poses), 2, 3))
    xi *= np.array([np.radians(angle_deg), distance_m])[:, None] / np.linalg.norm(
        xi, axis=-1, keepdims=True
    )
    xi[0] = 0.0
    return dict(enumerate(poses @ se3.exp(xi.reshape(-1, 6))))


def chain(poses: Mapping[int, Array], overlap: float = 0.2) -> list[Edge]:
    """Candidates between neighbours that say what the poses say."""
    return [
        Edge(i, i + 1, candidate(0, se3.inverse(poses[i + 1]) @ poses[i], 0.9, overlap))
        for i in range(len(poses) - 1)
    ]


def worst(found: Mapping[int, Array], truth: Array) -> tuple[float, float]:
    """Largest error of the poses in degrees and metres; the first is right."""
    angle, shift = se3.distance(np.stack([found[i] for i in sorted(found)]), truth)
    return float(np.degrees(angle.max())), float(shift.max())


def run(
    start: Mapping[int, Array],
    scans: Sequence[CompletedScan],
    edges: Sequence[Edge],
    planes: bool = False,
) -> Registered:
    return register(start, scans, edges, {0}, planes)


@pytest.mark.parametrize("seed", range(3))
def test_perturbed_poses_come_back(seed: int) -> None:
    truth, scans = room(seed)
    start = shaken(seed, truth, 1.5, 0.03)
    result = run(start, scans, chain(start))
    angle, shift = worst(result.pose, truth)
    assert angle < 0.3 and shift < 0.008
    assert result.outcome is not None and result.outcome.accepted
    assert result.outcome.residual_after_m < 0.5 * result.outcome.residual_before_m


def test_the_same_input_gives_the_same_bytes_and_fixed_scans_stay() -> None:
    truth, scans = room(5)
    start = shaken(5, truth, 1.0, 0.02)
    first, second = (register(start, scans, chain(start), {0, 2}, False) for _ in range(2))
    for i in start:
        assert first.pose[i].tobytes() == second.pose[i].tobytes()
        assert (first.pose[i].tobytes() == start[i].tobytes()) == (i in {0, 2})


def test_poses_that_fitting_makes_worse_are_kept() -> None:
    """What fits errs by 2 cm in one scan, what is held out does not."""
    rng = np.random.default_rng(7)
    points, normals = box(rng)
    truth = room_poses(rng, 3)
    truth[:, :3, 3] *= 0.1
    fits = np.arange(len(points)) % HELD_OUT != HELD_OUT - 1
    scans = [scan_of(pose, points, normals) for pose in truth]
    scans[1] = scan_of(truth[1], points + 0.02 * fits[:, None], normals)
    start = dict(enumerate(truth))
    result = run(start, scans, chain(start))
    assert result.outcome is not None and not result.outcome.accepted
    assert result.outcome.residual_after_m > result.outcome.residual_before_m
    for i in start:
        assert result.pose[i].tobytes() == start[i].tobytes()


def test_pulling_scans_apart_is_no_improvement() -> None:
    truth, scans = room(8)
    clouds = [Cloud.of(scan) for scan in scans]
    apart = truth.copy()
    apart[1:, :3, 3] += np.arange(1, SCANS)[:, None] * np.array([5.0, 0.0, 0.0])
    assert judge(clouds, truth, apart) is None
    apart[1] = truth[1]
    start = np.stack(list(shaken(8, truth, 0.0, 0.01).values()))
    outcome = judge(clouds, start, apart)
    assert outcome is not None and outcome.residual_after_m < outcome.residual_before_m
    assert not outcome.accepted


def test_scans_that_do_not_meet_stay_and_are_not_judged() -> None:
    rng = np.random.default_rng(9)
    points, normals = box(rng, 400)
    poses = room_poses(rng, 2)
    scans = [scan_of(poses[0], points, normals), scan_of(poses[1], points + 9.0, normals)]
    start = dict(enumerate(poses))
    result = run(start, scans, chain(start))
    assert result.outcome is None
    assert all(result.pose[i].tobytes() == start[i].tobytes() for i in start)


def test_links_keep_scans_from_sliding_along_a_wall() -> None:
    rng = np.random.default_rng(10)
    truth = np.stack([np.eye(4), np.eye(4)])
    walls = [np.column_stack([rng.uniform(-1, 1, (900, 2)), np.full(900, 2.0)]) for _ in truth]
    normals = np.tile([0.0, 0.0, -1.0], (900, 1))
    scans = [scan_of(pose, wall, normals) for pose, wall in zip(truth, walls, strict=True)]
    start = dict(enumerate(truth @ se3.exp(np.array([[0.0] * 6, [0.0, 0, 0, 0.05, 0, 0.03]]))))
    result = run(start, scans, chain(dict(enumerate(truth)), overlap=1.0))
    np.testing.assert_allclose(result.pose[1], truth[1], atol=2e-3)


def test_plane_factors_pull_a_drifting_chain_together() -> None:
    truth, scans = corridor(11)
    drift = se3.exp(np.array([0.0, 0.0, 0.012, 0.0, -0.015, 0.0]))
    motions = [se3.inverse(truth[i]) @ truth[i + 1] @ drift for i in range(SCANS - 1)]
    start = {0: truth[0]}
    for i, motion in enumerate(motions):
        start[i + 1] = start[i] @ motion
    edges = chain(start)
    assert worst(start, truth)[0] > 2.0
    loose, held = (run(start, scans, edges, planes) for planes in (False, True))
    assert held.outcome is not None and held.outcome.accepted
    assert worst(held.pose, truth)[0] < 0.3 * worst(loose.pose, truth)[0]


def facing(rng: np.random.Generator) -> Facing:
    n_p, n_q = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, 7, 3)))
    p, q = rng.normal(size=(2, 7, 3))
    return Facing(0, 1, p, n_p, q, n_q, rng.uniform(1.0, 2.0, 7), 0.7)


def robust_energy(term: Facing, poses: Array) -> float:
    """Geman-McClure's loss of the distances along both normals."""
    gap = se3.transform(poses[0], term.p) - se3.transform(poses[1], term.q)
    along = [se3.rotate(poses[0], term.n_p), se3.rotate(poses[1], term.n_q)]
    squared = [(gap * n).sum(axis=1) ** 2 for n in along]
    loss = [term.scale**2 * s / (term.scale**2 + s) for s in squared]
    return float(0.5 * (term.information * (loss[0] + loss[1])).sum())


@pytest.mark.parametrize("moved", [0, 1])
def test_gradients_of_facing_points_match_finite_differences(moved: int) -> None:
    rng = np.random.default_rng(12)
    term, poses = facing(rng), room_poses(rng, 2)
    _, gradient = term.blocks(poses)
    sign = 1.0 if moved == 0 else -1.0
    for k in range(6):
        xi = np.zeros((2, 6))
        xi[moved, k] = 1e-6
        ahead, behind = (robust_energy(term, se3.exp(s * xi) @ poses) for s in (1.0, -1.0))
        assert sign * gradient[k] == pytest.approx((ahead - behind) / 2e-6, abs=1e-5)


def test_a_step_brings_linked_poses_where_their_candidates_ask() -> None:
    rng = np.random.default_rng(13)
    truth = room_poses(rng, SCANS)
    edges = chain(dict(enumerate(truth)))
    links = [Link.of(edge.source, edge.target, edge) for edge in edges]
    poses = np.stack(list(shaken(13, truth, 3.0, 0.1).values()))
    for _ in range(20):
        step = gauss_newton_step(poses, links, {0})
        assert not step[0].any()
        poses = se3.exp(step) @ poses
    np.testing.assert_allclose(poses, truth, atol=1e-6)


def solved(
    start: Mapping[int, Array], edges: Sequence[Edge]
) -> tuple[GlobalSolution, list[PairResult]]:
    """What `solve` would say of these poses, with one more scan that has none."""
    placements = [ScanPlacement(f"scan {i}", 0, pose, 0.9, None) for i, pose in start.items()]
    solution = GlobalSolution(
        placements=(*placements, ScanPlacement("lost", None, None, 0.0, "nothing")),
        components=(Component(tuple(start), "gravity"),),
        selected={(e.source, e.target): e.candidate.rank for e in edges},
        initial_world_T_scan=start,
        edges=(),
    )
    pairs = [PairResult(e.source, e.target, PairStatus.OK, (e.candidate,)) for e in edges]
    return solution, pairs


def test_refining_a_solution_registers_and_levels_its_components() -> None:
    truth, scans = room(14)
    start = shaken(14, truth, 1.5, 0.03)
    solution, pairs = solved(start, chain(start))
    scans.append(replace(scans[0], name="lost"))
    refined = refine(solution, pairs, scans, GlobalConfig())
    found = [p.world_T_scan for p in refined.placements]
    assert found[SCANS] is None
    for i, j in itertools.combinations(range(SCANS), 2):
        ours, true = se3.inverse(found[i]) @ found[j], se3.inverse(truth[i]) @ truth[j]
        angle, shift = se3.distance(ours, true)
        assert np.degrees(angle) < 0.4 and shift < 0.01
    component = refined.components[0]
    assert component.registration is not None and component.registration.accepted
    assert component.world == "floor"
    assert [p[2, 3] for p in found[:SCANS]] == pytest.approx(truth[:, 2, 3], abs=0.01)
    before = [se3.inverse(p[0]) @ p[1] for p in (start, refined.initial_world_T_scan)]
    np.testing.assert_allclose(before[0], before[1], atol=1e-9)


def test_without_registration_a_solution_stays_as_it_is() -> None:
    truth, scans = room(15)
    start = dict(enumerate(truth))
    solution, pairs = solved(start, chain(start))
    assert refine(solution, pairs, scans, GlobalConfig(registration=False)) is solution
