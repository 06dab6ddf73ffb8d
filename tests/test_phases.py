"""Verdicts of the training's second and third phase."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

import fit_joint
from fewview import weights
from fewview.types import Array, BoolArray
from parameters import judge

OVERLAP = np.array([0.5] * 40 + [0.0] * 20)


def hits(share: float, count: int = 60) -> BoolArray:
    """(count, 5) of which the first candidate is right in a share of the pairs."""
    out = np.zeros((count, 5), dtype=bool)
    out[: round(share * count), 0] = True
    return out


def errors(deg: float, metres: float) -> Array:
    return np.broadcast_to(np.array([deg, metres]), (60, 4, 2)).copy()


def test_gammas_that_win_pairs_are_shipped_and_no_others() -> None:
    better = judge.judged_spectral(hits(0.5), hits(0.7), OVERLAP)
    assert better["ship"] and better["top_1"]["better"] == 12 and better["top_1"]["worse"] == 0
    assert better["top_1"]["overlapping"] == {"pairs": 40, "old": 0.75, "learned": 1.0}
    assert not judge.judged_spectral(hits(0.5), hits(0.55), OVERLAP)["ship"]
    assert not judge.judged_spectral(hits(0.7), hits(0.5), OVERLAP)["ship"]


def test_alphas_that_bring_pairs_nearer_are_shipped_and_no_others() -> None:
    start, near, far = errors(10.0, 0.2), errors(2.0, 0.05), errors(4.0, 0.2)
    found = judge.judged_regression(start, far, near, OVERLAP)
    assert found["ship"] and found["better"] == 60
    assert found["apart"]["learned"]["worse_than_start"] == 0.0
    assert not judge.judged_regression(start, near, far, OVERLAP)["ship"]
    spoilt = near.copy()
    spoilt[40:45] = 90.0
    assert not judge.judged_regression(start, far, spoilt, OVERLAP)["ship"]


def figures(factor: float) -> dict[str, float]:
    losses = dict.fromkeys(fit_joint.LOSSES, factor)
    losses["spectral_loss"] = factor - 1.0
    return losses | {"seen_mean": 0.8, "predicted_mean": 0.6, "log_depth": factor}


def test_a_joint_run_is_shipped_when_nothing_got_worse() -> None:
    before, after = figures(0.5), figures(0.4)
    assert fit_joint.score(before, before) == 1.0
    assert fit_joint.score(before, after) == pytest.approx(0.8)
    assert fit_joint.ship(before, after) and not fit_joint.ship(after, before)
    assert not fit_joint.ship(before, after | {"predicted_mean": 0.59})


def test_the_networks_of_a_joint_run_come_apart(tmp_path: Path) -> None:
    state = {"log_alphas": torch.zeros(6), "log_gammas": torch.zeros(3)}
    for name in fit_joint.NETWORKS:
        state |= {f"{name}.{key}": value + 1.0 for key, value in weights.load(name)[0].items()}
    card = {"seed": 0, "steps": 3, "hours": 0.1, "hardware": "here", "validation": {}}
    weights.save("joint", tmp_path, state, card)
    fit_joint.split(tmp_path, tmp_path)
    for name in fit_joint.NETWORKS:
        shipped, before = weights.load(name)
        found, after = weights.load(name, tmp_path)
        assert found.keys() == shipped.keys()
        assert all(torch.equal(found[key], shipped[key] + 1.0) for key in shipped)
        assert after["joint"]["steps"] == 3 and after["sha256"] != before["sha256"]
    assert fit_joint.learned(tmp_path) == {"gammas": [1.0] * 3, "alphas": [1.0] * 6}
