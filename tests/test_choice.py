"""Which candidates of a pair are kept."""

from __future__ import annotations

import numpy as np

from fewview.choice import chosen
from fewview.geometry import se3
from fewview.types import Array


def turned(*degrees: float) -> Array:
    angles = np.radians(degrees)[:, None] * [0.0, 0.0, 1.0]
    return se3.pose(se3.rotation_exp(angles), np.zeros((len(degrees), 3)))


def test_the_most_probable_comes_first() -> None:
    order = chosen(np.array([0.1, 0.6, 0.2]), turned(0, 90, 180), np.full(3, 0.25), 3)
    assert order.tolist() == [1, 2, 0]


def test_where_nothing_is_sure_every_rotation_is_kept() -> None:
    probability = np.array([0.05, 0.04, 0.03, 0.01, 0.01])
    order = chosen(probability, turned(0, 2, 4, 90, 180), np.full(5, 0.3), 3)
    assert order.tolist() == [0, 3, 4]


def test_a_sure_shift_is_worth_more_than_an_unlikely_rotation() -> None:
    order = chosen(np.array([0.5, 0.4, 0.0]), turned(0, 1, 180), np.full(3, 0.25), 2)
    assert order.tolist() == [0, 1]


def test_where_no_pose_can_be_told_the_likelier_rotation_comes_first() -> None:
    order = chosen(np.array([0.02, 0.01]), turned(0, 180), np.array([0.1, 0.7]), 2)
    assert order.tolist() == [1, 0]


def test_no_more_than_there_are() -> None:
    assert len(chosen(np.zeros(2), turned(0, 90), np.zeros(2), 5)) == 2
    assert len(chosen(np.zeros(0), np.zeros((0, 4, 4)), np.zeros(0), 5)) == 0
