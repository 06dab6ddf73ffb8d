"""Pair tables from end to end: rows, groups, rows that wait for a network, same bytes again."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
import pytest

from benchmark import command, pair_table, scoring
from benchmark.catalogue import PAIR_METHODS
from fewview import synthetic

Json = dict[str, Any]


@pytest.fixture(scope="module")
def options(tmp_path_factory: pytest.TempPathFactory) -> argparse.Namespace:
    folder = tmp_path_factory.mktemp("data")
    seed = synthetic.split_seed("validation", 5)
    synthetic.write(folder / "room", synthetic.generate(seed, 4, width=160, height=120))
    made = command.pair_parser(None, "test")
    return made.parse_args(
        ["--dataset", str(folder / "room"), "--cache", str(folder / "cache")]
        + ["--out", str(folder / "out" / "table.json"), "--count", "4", "--jobs", "1"]
    )


def row(overlap: float, yaw: float, errors: list[float], right: int | None = None) -> Json:
    """A scored pair whose candidates have these rotation errors."""
    candidates = [
        {
            "rank": k,
            "rotation_deg": error,
            "translation_m": 0.1,
            "centroid_m": 0.1,
            "right": k == right,
        }
        for k, error in enumerate(errors)
    ]
    nothing = {"rotation_deg": 90.0, "translation_m": 1.0, "centroid_m": 1.0, "right": False}
    return {
        "overlap": overlap,
        "yaw_deg": yaw,
        "candidates": candidates,
        "identity": nothing,
        "selected": 0 if errors else None,
        "error": None,
        "match_seconds": 0.1,
    }


@pytest.mark.slow
def test_table_from_end_to_end(options: argparse.Namespace) -> None:
    methods = {name: PAIR_METHODS[name] for name in ("identity", "scan_complete")}
    results, text = pair_table.make(options, methods, "Test")
    assert results["methods"]["identity"]["overlap"]["all"]["count"] == 4
    assert results["difficulty"]["pairs"] == 4
    assert sum(line.startswith("| ScanComplete") for line in text.splitlines()) > 1
    before = {p.name: p.read_bytes() for p in options.out.parent.iterdir()}
    pair_table.make(options, methods, "Test")
    assert {p.name: p.read_bytes() for p in options.out.parent.iterdir()} == before
    assert set(before) == {"table.json", "table.md", "table.tex"}


def test_groups_hold_their_pairs() -> None:
    rows = [row(0.005, 170.0, []), row(0.05, 100.0, [5.0]), row(0.6, 10.0, [1.0], right=0)]
    groups = scoring.summarise(rows, scoring.OVERLAPS)
    assert {name: group["count"] for name, group in groups.items()} == {
        ">= 10 %": 1,
        "< 10 %": 2,
        "< 1 %": 1,
        "> 50 %": 1,
        "all": 3,
    }
    yaw = scoring.summarise(rows, scoring.yaw_classes())
    assert [group["count"] for group in yaw.values()] == [1, 1, 1]


def test_a_pair_without_an_answer_counts_with_the_identity() -> None:
    found = scoring.summarise([row(0.5, 0.0, []), row(0.5, 0.0, [10.0])], scoring.OVERLAPS)["all"]
    assert found["top"]["1"]["rotation_deg"] == pytest.approx(50.0)
    assert found["without_candidates"] == 1


def test_top_k_takes_the_best_rotation_and_recall_any_right_one() -> None:
    found = scoring.summarise([row(0.5, 0.0, [90.0, 2.0, 1.0], right=1)], scoring.OVERLAPS)["all"]
    assert [found["top"][k]["rotation_deg"] for k in ("1", "3", "5")] == [90.0, 1.0, 1.0]
    assert [found["recall"][k] for k in ("1", "3", "5")] == [0.0, 1.0, 1.0]


def test_rank_distribution() -> None:
    rows = [row(0.5, 0.0, [3.0, 1.0]), row(0.5, 0.0, [1.0, 3.0]), row(0.5, 0.0, [])]
    ranks = scoring.best_ranks(rows)
    assert (ranks["answered"], ranks["of"]) == (2, 3)
    np.testing.assert_allclose(ranks["shares"], [0.5, 0.5, 0.0, 0.0, 0.0])
