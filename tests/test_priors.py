"""What the user knows: the file, what it does to pairs and levellings, and to the answer."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
import yaml

from benchmark.planted_graphs import (
    Noise,
    candidate,
    pair_result,
    planted_graph,
    room_poses,
    shaken,
    upright_levelling,
)
from fewview import pipeline, scans
from fewview.cli import ALL_PLACED, BAD_INPUT, main
from fewview.completion.levelling import level, turns_upright, upright
from fewview.config import Config, GlobalConfig, merge
from fewview.errors import PriorsError
from fewview.geometry import se3
from fewview.global_stage import solve
from fewview.priors import PairPrior, Priors, load
from fewview.priors.known import constrained
from fewview.types import (
    Array,
    CandidateOrigin,
    Frame,
    GlobalSolution,
    Intrinsics,
    PairResult,
    PairStatus,
    Surface,
)

NAMES = ("000008", "1e3", "table", "window")
MOTION = se3.exp(np.array([0.3, -0.2, 0.9, 1.0, 2.0, -0.5]))
SHIFT = "[[1, 0, 0, 2], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"
SAME, SHIFTED = np.eye(4).tolist(), yaml.safe_load(SHIFT)


def read(folder: Path, text: str, top_k: int | None = None) -> Priors:
    (folder / "priors.yaml").write_text(text)
    return load(folder / "priors.yaml", NAMES, top_k)


def run(poses: Array, pairs: Sequence[PairResult], priors: Priors | None = None) -> GlobalSolution:
    """The global stage as the pipeline calls it."""
    priors = priors or Priors()
    names = [f"scan-{i}" for i in range(len(poses))]
    told = [priors.constrain(pair) for pair in pairs]
    levellings = [upright_levelling(pose) for pose in poses]
    solution = solve(names, levellings, told, GlobalConfig(), 0, priors.poses)
    priors.check(told, solution)
    return solution


def right(poses: Array, source: int, target: int) -> Array:
    return se3.inverse(poses[target]) @ poses[source]


def links(poses: Array, pairs: Sequence[tuple[int, int]], probability: float) -> list[PairResult]:
    """Pairs whose only candidate is right, up to noise; all other pairs say nothing."""
    rng = np.random.default_rng(1)
    out = []
    for s, t in itertools.combinations(range(len(poses)), 2):
        motion = shaken(rng, right(poses, s, t), Noise(1.0, 0.03))
        found = [candidate(0, motion, probability, 0.5)] if (s, t) in pairs else []
        out.append(pair_result(s, t, found))
    return out


def off(solution: GlobalSolution, poses: Array, source: int, target: int) -> float:
    """Metres between the relative pose of two placed scans and the true one."""
    found = [solution.placements[i].world_T_scan for i in (source, target)]
    assert found[0] is not None and found[1] is not None
    _, shift = se3.distance(se3.inverse(found[1]) @ found[0], right(poses, source, target))
    return float(shift)


# The file


def test_everything_that_can_be_said(tmp_path: Path) -> None:
    priors = read(
        tmp_path,
        f"""
        up: {{table: [0, -2, 0], "*": [0, 0, 1e-3]}}
        poses: {{000008: {SHIFT}}}
        pairs:
          - {{source: 1e3, target: table, target_T_source: {json.dumps(MOTION.tolist())}}}
          - {{source: window, target: 1e3, target_T_source: {json.dumps(MOTION.tolist())}}}
          - {{source: window, target: table, pin: 2, veto: [0, 1]}}
          - {{source: 000008, target: window, veto: all}}
        """,
        top_k=3,
    )
    assert priors.names == NAMES
    np.testing.assert_allclose(
        [priors.up[i] for i in range(4)], [[0, 0, 1]] * 2 + [[0, -1, 0], [0, 0, 1]]
    )
    assert list(priors.poses) == [0] and priors.poses[0][0, 3] == 2.0
    assert list(priors.pairs) == [(1, 2), (1, 3), (2, 3), (0, 3)]
    forward, backward = priors.pairs[1, 2].target_T_source, priors.pairs[1, 3].target_T_source
    assert forward is not None and backward is not None
    np.testing.assert_allclose(forward, MOTION, atol=1e-12)
    np.testing.assert_allclose(backward @ MOTION, np.eye(4), atol=1e-12)
    assert priors.pairs[2, 3] == PairPrior(None, 2, frozenset({0, 1}))
    assert priors.pairs[0, 3].veto == "all"


def test_the_documented_example_is_read(tmp_path: Path) -> None:
    text = (Path(__file__).parents[1] / "docs" / "data.md").read_text()
    section = text.partition("## What you know already")[2].partition("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("    ")]
    (tmp_path / "known.yaml").write_text("\n".join(lines))
    priors = load(tmp_path / "known.yaml", ("desk", "door", "hall"), top_k=5)
    assert sorted(priors.up) == [0, 1, 2] and list(priors.poses) == [2]
    assert sorted(priors.pairs) == [(0, 1), (0, 2), (1, 2)]


def test_json_is_read_and_one_direction_serves_all(tmp_path: Path) -> None:
    priors = read(tmp_path, json.dumps({"up": [0.0, -3.0, 0.0]}))
    assert sorted(priors.up) == [0, 1, 2, 3]
    np.testing.assert_allclose(priors.up[3], [0, -1, 0])
    assert read(tmp_path, "") == Priors(NAMES)


def test_fixed_poses_stay_as_written(tmp_path: Path) -> None:
    rounded = np.round(MOTION, 5)
    priors = read(tmp_path, json.dumps({"poses": {"table": rounded.tolist()}}))
    np.testing.assert_array_equal(priors.poses[2], rounded)


PAIR = "pairs: [{source: table, target: window, %s}]"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("up:\n  [0, -1", "not a readable YAML file .line 2: expected ',' or ']'"),
        ("[1, 2]", "the file must hold named values"),
        ("ups: [0, -1, 0]", "unknown key 'ups'; there are up, poses, pairs"),
        ("up: {table: [0, -1, 0], table: [0, 1, 0]}", "line 1: 'table' comes twice"),
        ("up: {tabel: [0, -1, 0]}", "no scan 'tabel'; did you mean 'table'. there are 000008"),
        ("up: [0, -1]", "must be 3 finite numbers"),
        ("up: [0, nan, 0]", "must be 3 finite numbers"),
        ("up: [0, 0, 0]", "cannot be zero"),
        ("up:", "up must hold named values"),
        ("poses: {8: [[1]]}", "no scan '8'"),
        ("poses: {table: [[1, 0], [0]]}", "must be 4 x 4 finite numbers"),
        (f"poses: {{table: {SHIFT.replace('1, 0, 0, 2', '2, 0, 0, 2')}}}", "not orthonormal"),
        (f"poses: {{table: {SHIFT.replace('1, 0, 0, 2', '-1, 0, 0, 2')}}}", "mirror"),
        (f"poses: {{table: {SHIFT.replace('0, 0, 0, 1]', '2, 0, 0, 1]')}}}", "last row"),
        ("pairs: {source: table}", "must be a list"),
        ("pairs: [{source: table, pin: 0}]", "entry 1: 'target' is missing"),
        ("pairs: [{source: table, target: table, pin: 0}]", "two different scans"),
        ("pairs: [{source: table, target: door, pin: 0}]", "no scan 'door'"),
        ("pairs: [{source: table, target: window}]", "says nothing"),
        (PAIR % "pinned: 0", "unknown key 'pinned'"),
        (PAIR % "pin: -1", "whole numbers from 0 up"),
        (PAIR % "pin: 3", "no rank 3; this run keeps 3 candidates"),
        (PAIR % "veto: [0, 7]", "no rank 7"),
        (PAIR % "veto: none", "a list of ranks, or all"),
        (PAIR % "pin: 1, veto: [0, 1]", "both pinned and vetoed"),
        (PAIR % "pin: 1, veto: all", "both pinned and vetoed"),
        (PAIR % f"pin: 1, target_T_source: {SHIFT}", "not both"),
        (
            "pairs: [{source: table, target: window, pin: 0}, "
            "{source: window, target: table, veto: all}]",
            "entry 2 .window - table. comes twice",
        ),
        (
            f"poses: {{table: {SHIFT}, window: {SHIFT}}}\n{PAIR % 'pin: 0'}",
            "settled by its two fixed poses",
        ),
    ],
)
def test_bad_files_are_refused(text: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(PriorsError, match=words) as refused:
        read(tmp_path, text, top_k=3)
    assert "\n" not in str(refused.value) and "priors.yaml" in str(refused.value)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PriorsError, match="none.yaml"):
        load(tmp_path / "none.yaml", NAMES)


# Pairs


def weighed(probabilities: Sequence[float]) -> PairResult:
    return pair_result(0, 1, [candidate(k, MOTION, p) for k, p in enumerate(probabilities)])


def probabilities(pair: PairResult) -> list[float]:
    return [c.probability for c in pair.candidates]


def test_a_pin_takes_all_the_probability() -> None:
    pair = constrained(weighed([0.7, 0.2, 0.01]), PairPrior(pin=2))
    assert probabilities(pair) == [0.0, 0.0, 1.0]
    assert [c.told for c in pair.candidates] == [False, False, True]


def test_a_veto_leaves_the_rest_to_the_others_and_to_none() -> None:
    pair = constrained(weighed([0.6, 0.2, 0.1]), PairPrior(veto=frozenset({0})))
    np.testing.assert_allclose(probabilities(pair), [0.0, 0.5, 0.25])
    assert pair.status is PairStatus.OK and not any(c.told for c in pair.candidates)
    assert [c.vetoed for c in pair.candidates] == [True, False, False]


@pytest.mark.parametrize("veto", ["all", frozenset({0, 1})])
def test_a_silenced_pair_says_so(veto: object) -> None:
    pair = constrained(weighed([1.0, 0.0]), PairPrior(veto=veto))  # type: ignore[arg-type]
    assert probabilities(pair) == [0.0, 0.0]
    assert (
        pair.status is PairStatus.NOTHING_BELIEVABLE and pair.reason == "every candidate was vetoed"
    )


def test_a_given_pose_is_a_candidate_of_its_own() -> None:
    failed = PairResult(0, 1, PairStatus.FAILED, (), "broke")
    for pair in (weighed([0.9, 0.05]), failed):
        settled = constrained(pair, PairPrior(MOTION))
        *others, given = settled.candidates
        assert [c.probability for c in others] == [0.0] * len(pair.candidates)
        assert (given.rank, given.probability, given.origin) == (
            len(others),
            1.0,
            CandidateOrigin.GIVEN,
        )
        assert settled.status is PairStatus.OK and settled.reason is None
        np.testing.assert_array_equal(given.target_T_source, MOTION)


def test_pairs_that_nothing_is_known_of_are_untouched() -> None:
    pair = weighed([0.5])
    assert Priors(NAMES, pairs={(0, 2): PairPrior(pin=0)}).constrain(pair) is pair


def test_a_rank_that_the_run_does_not_have_is_refused() -> None:
    priors = Priors(NAMES, pairs={(0, 1): PairPrior(pin=2)})
    with pytest.raises(
        PriorsError, match="000008 - 1e3 has 2 candidates in this run, none of rank 2"
    ):
        priors.constrain(weighed([0.5, 0.1]))


# The answer


def deceived() -> tuple[Array, list[PairResult]]:
    """Two scans; a wrong candidate outweighs the right one."""
    poses = room_poses(np.random.default_rng(0), 2)
    truth = right(poses, 0, 1)
    wrong = truth @ se3.exp(np.array([0.0, 2.0, 0.0, 1.0, 0.0, 0.0]))
    return poses, [pair_result(0, 1, [candidate(0, wrong, 0.75), candidate(1, truth, 0.2)])]


def test_a_veto_of_a_wrong_candidate_changes_the_answer() -> None:
    poses, pairs = deceived()
    assert off(run(poses, pairs), poses, 0, 1) > 0.5
    vetoed = run(poses, pairs, Priors(pairs={(0, 1): PairPrior(veto=frozenset({0}))}))
    assert vetoed.selected == {(0, 1): 1}
    assert off(vetoed, poses, 0, 1) < 1e-3
    silenced = run(poses, pairs, Priors(pairs={(0, 1): PairPrior(veto="all")}))
    assert silenced.components == ()
    assert silenced.placements[0].reason == "no candidate pose links it to any other scan"


def test_a_pin_outweighs_every_loop_against_it() -> None:
    poses, pairs = planted_graph(4, 6, 2, link_rate=1.0, strength=(0.9, 0.95))
    elsewhere = right(poses, 0, 1) @ se3.exp(np.array([0.0, 2.5, 0.0, 1.0, 0.5, 0.0]))
    first = pair_result(
        0, 1, [candidate(0, right(poses, 0, 1), 0.9), candidate(1, elsewhere, 0.01)]
    )
    pairs[0] = first
    assert run(poses, pairs).selected[0, 1] == 0
    assert run(poses, pairs, Priors(pairs={(0, 1): PairPrior(pin=1)})).selected[0, 1] == 1


def test_a_given_relative_pose_joins_scans_that_nothing_else_joins() -> None:
    poses = room_poses(np.random.default_rng(3), 4)
    pairs = links(poses, [(0, 1), (2, 3)], 0.9)
    priors = Priors(pairs={(1, 2): PairPrior(right(poses, 1, 2))})
    solution = run(poses, pairs, priors)
    assert solution.components[0].scans == (0, 1, 2, 3)
    assert solution.components[0].world == "floor"
    assert off(solution, poses, 1, 2) < 2e-3


def given_world(poses: Array, fixed: Sequence[int]) -> tuple[Array, Priors]:
    """The true poses in a world of the user's, some of them fixed."""
    world = se3.exp(np.array([1.0, 0.4, -2.0, 30.0, -20.0, 5.0])) @ poses
    return world, Priors(poses={i: world[i] for i in fixed})


def errors(solution: GlobalSolution, world: Array) -> Array:
    """(n,) metres between the placements and the given world's poses."""
    found = np.array([placement.world_T_scan for placement in solution.placements])
    return np.linalg.norm(found[:, :3, 3] - world[:, :3, 3], axis=1)


@pytest.mark.parametrize("fixed", [[3], [1, 4], [0, 2, 5]])
def test_fixed_poses_are_kept_and_make_the_world(fixed: list[int]) -> None:
    poses = room_poses(np.random.default_rng(5), 6)
    ring = [(i, j) for i in range(6) for j in range(i + 1, 6) if j - i in (1, 2, 4, 5)]
    world, priors = given_world(poses, fixed)
    solution = run(poses, links(poses, ring, 0.8), priors)
    assert [(c.scans, c.world) for c in solution.components] == [(tuple(range(6)), "given")]
    for i in fixed:
        np.testing.assert_allclose(solution.placements[i].world_T_scan, world[i], atol=1e-6)
        np.testing.assert_allclose(solution.initial_world_T_scan[i], world[i], atol=1e-6)
        assert solution.placements[i].probability == 1.0
    others = [p.probability for i, p in enumerate(solution.placements) if i not in fixed]
    assert min(others) > 0.9 and max(others) < 1.0
    assert errors(solution, world).max() < 0.15


def test_fixed_poses_join_components_that_nothing_else_joins() -> None:
    poses = room_poses(np.random.default_rng(6), 6)
    pairs = links(poses, [(0, 1), (0, 2), (1, 2), (3, 4), (3, 5), (4, 5)], 0.9)
    assert len(run(poses, pairs).components) == 2
    world, priors = given_world(poses, [1, 4])
    solution = run(poses, pairs, priors)
    assert [c.scans for c in solution.components] == [(0, 1, 2, 3, 4, 5)]
    assert errors(solution, world).max() < 0.15


def test_fixed_poses_withstand_loops_that_agree_on_something_else() -> None:
    poses = room_poses(np.random.default_rng(7), 8)
    everything = [(i, j) for i in range(8) for j in range(i + 1, 8)]
    moved = poses.copy()
    moved[4:] = se3.exp(np.array([0.0, 0.0, 2.0, 3.0, 0.0, 0.0])) @ poses[4:]
    world, priors = given_world(poses, [0, 4])
    solution = run(poses, links(moved, everything, 0.95), priors)
    for i in (0, 4):
        np.testing.assert_allclose(solution.placements[i].world_T_scan, world[i], atol=1e-6)
    assert solution.placements[0].component == solution.placements[4].component


def test_the_pose_graph_starts_from_the_fixed_poses() -> None:
    """All that was found is off by what the discrete stage still tolerates."""
    poses = room_poses(np.random.default_rng(7), 6)
    everything = list(itertools.combinations(range(6), 2))
    moved = poses.copy()
    moved[3:] = se3.exp(np.array([0.0, 0.0, 0.0, 0.35, 0.0, 0.0])) @ poses[3:]
    world, priors = given_world(poses, [0, 4])
    solution = run(poses, links(moved, everything, 0.95), priors)
    np.testing.assert_allclose(solution.initial_world_T_scan[4], world[4], atol=1e-6)
    given = next(edge for edge in solution.edges if (edge.source, edge.target) == (0, 4))
    assert given.before_m < 1e-6 and given.after_m < 2e-3


def test_a_fixed_scan_without_any_link_is_placed() -> None:
    poses = room_poses(np.random.default_rng(8), 4)
    world, priors = given_world(poses, [3])
    solution = run(poses, links(poses, [(0, 1), (0, 2), (1, 2)], 0.9), priors)
    assert [(c.scans, c.world) for c in solution.components] == [
        ((0, 1, 2), "floor"),
        ((3,), "given"),
    ]
    np.testing.assert_array_equal(solution.placements[3].world_T_scan, world[3])
    assert solution.placements[3].probability == 1.0


def test_doubt_is_relative_to_the_fixed_scans() -> None:
    """A strong cluster hangs on the fixed scan by one weak link."""
    poses = room_poses(np.random.default_rng(9), 5)
    pairs = links(poses, [(i, j) for i in range(4) for j in range(i + 1, 4)], 0.9)
    weak = candidate(0, right(poses, 3, 4), 0.7)
    pairs[-1] = pair_result(3, 4, [weak])
    free = [p.probability for p in run(poses, pairs).placements]
    assert min(free[:4]) > 0.95 and free[4] < 0.75
    _, priors = given_world(poses, [4])
    held = [p.probability for p in run(poses, pairs, priors).placements]
    assert max(held[:4]) < 0.75 and held[4] == 1.0


def test_what_contradicts_itself_is_refused() -> None:
    poses = room_poses(np.random.default_rng(10), 3)
    apart = right(poses, 0, 2) @ se3.exp(np.array([0.0, 1.5, 0.0, 2.0, 0.0, 0.0]))
    told: Mapping[tuple[int, int], PairPrior] = {
        (0, 1): PairPrior(right(poses, 0, 1)),
        (1, 2): PairPrior(right(poses, 1, 2)),
        (0, 2): PairPrior(apart),
    }
    with pytest.raises(PriorsError, match="contradicts what is told of other pairs"):
        run(poses, links(poses, [], 0.0), Priors(NAMES, pairs=told))


# Up directions


def ambiguous() -> tuple[Surface, Array]:
    """A camera pitched down by 50 degrees that sees nothing but the floor, and its true up."""
    rng = np.random.default_rng(0)
    pitch = np.radians(50.0)
    up = np.array([0.0, -np.cos(pitch), -np.sin(pitch)])
    forward = np.array([0.0, -np.sin(pitch), np.cos(pitch)])
    ground = rng.uniform([-1, 0.3], [1, 2.0], (500, 2))
    points = -1.4 * up + ground[:, :1] * [1.0, 0.0, 0.0] + ground[:, 1:] * forward
    return Surface(
        points, np.tile(up, (500, 1)), np.zeros((500, 3), np.float32), np.full(500, -1)
    ), up


def test_a_told_up_settles_an_ambiguous_gravity() -> None:
    surface, up = ambiguous()
    guessed = level(surface, ())
    assert guessed.level_R_scan[2] @ up < np.cos(np.radians(20.0)) and guessed.floor_z is None
    told = level(surface, (), up=up)
    np.testing.assert_allclose(told.level_R_scan[2], up)
    np.testing.assert_allclose(told.level_R_scan @ told.level_R_scan.T, np.eye(3), atol=1e-12)
    assert told.up_confidence == 1.0 and not told.manhattan
    assert told.floor_z == pytest.approx(-1.4)


def test_a_told_up_is_kept_where_nothing_is_seen() -> None:
    surface, up = ambiguous()
    empty = Surface(
        surface.points[:0], surface.normals[:0], surface.colours[:0], surface.labels[:0]
    )
    levelling = level(empty, (), up=up)
    np.testing.assert_allclose(levelling.level_R_scan[2], up)
    assert levelling.up_confidence == 1.0 and levelling.floor_z is None


@pytest.mark.parametrize("turns", range(4))
def test_the_image_is_turned_towards_a_told_up(turns: int) -> None:
    tilted = upright(turns) + [0.3, 0.2, -0.9]
    assert turns_upright(tilted) == turns


# The whole way


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three small scans of a wall."""
    path = tmp_path_factory.mktemp("priors") / "scans"
    colour = np.random.default_rng(0).integers(0, 255, (48, 64, 3), np.uint8)
    wall = Frame(colour, np.full((48, 64), 2.0, np.float32), Intrinsics(64, 48, 60, 60, 31.5, 23.5))
    scans.write(path, [("a", wall), ("b", wall), ("c", wall)])
    return path


def reconstruct(folder: Path, out: Path, values: object) -> int:
    (out / "priors.yaml").write_text(json.dumps(values))
    return main(
        ["reconstruct", str(folder), "--out", str(out / "mesh.ply"), "--no-rrd", "--no-store"]
        + [
            "--top-k",
            "20",
            "--set",
            "features.kinds=[planes]",
            "--set",
            "features.quarter_turns=false",
        ]
        + ["--priors", str(out / "priors.yaml")]
    )


def test_a_run_takes_what_is_known(folder: Path, tmp_path: Path) -> None:
    poses = {"a": np.eye(4).tolist(), "b": MOTION.tolist(), "c": SHIFTED}
    assert reconstruct(folder, tmp_path, {"poses": poses}) == ALL_PLACED
    report = json.loads((tmp_path / "mesh.json").read_text())
    for scan in report["scans"]:
        np.testing.assert_allclose(scan["world_T_scan"], poses[scan["name"]], atol=1e-6)
        assert scan["probability"] == 1.0
    assert report["components"][0]["world"] == "given"
    for pair in report["pairs"]:
        given = pair["candidates"][pair["selected"]]
        assert (given["origin"], given["probability"]) == ("given", 1.0)


def test_a_run_takes_up_directions(folder: Path) -> None:
    config = merge(Config(), {"features": {"kinds": ["planes"]}}, "test")
    up = np.array([0.8, 0.0, -0.6])
    result = pipeline.reconstruct(scans.load(folder), config, priors=Priors(up={1: up}))
    guessed, told, _ = result.completed
    np.testing.assert_allclose(told.levelling.level_R_scan[2], up)
    assert (told.levelling.up_confidence, told.quarter_turns) == (1.0, 1)
    assert (guessed.levelling.up_confidence < 1.0, guessed.quarter_turns) == (True, 0)


def pair_entry(source: str, target: str, **known: object) -> dict[str, object]:
    return {"source": source, "target": target, **known}


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ([pair_entry("a", "b", pin=99)], "no rank 99"),
        ([pair_entry("a", "b", pin=19)], "a - b has"),
        (
            [
                pair_entry("a", "b", target_T_source=SAME),
                pair_entry("b", "c", target_T_source=SAME),
                pair_entry("c", "a", target_T_source=SHIFTED),
            ],
            "contradicts what is told",
        ),
    ],
)
def test_bad_priors_leave_nothing(
    entries: object,
    words: str,
    folder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert reconstruct(folder, tmp_path, {"pairs": entries}) == BAD_INPUT
    assert words in capsys.readouterr().err.splitlines()[-1]
    assert [path.name for path in tmp_path.iterdir()] == ["priors.yaml"]
