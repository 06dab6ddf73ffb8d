"""A scan from above: what its channels show."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from box_rooms import COLOURS, box_room

from fewview.alignment import draw
from fewview.alignment.drawing import LEVEL_COLOURS, SHOWN, UPRIGHT_COLOURS
from fewview.completion.layout.grid import CELL_M, CELLS
from fewview.types import Array, CompletedLayout, FloatArray, RingScan

SIZE = 64
EYE, ABOVE, TABLE, FLOOR, TOP = range(SHOWN.start, SHOWN.stop)
*_, UNEVEN = range(UPRIGHT_COLOURS.start, UPRIGHT_COLOURS.stop)


def wall() -> RingScan:
    """A grey wall two metres ahead."""
    depth = np.zeros((SIZE, 4 * SIZE), np.float32)
    depth[:, SIZE : 2 * SIZE] = 2.0
    return RingScan(np.full((SIZE, 4 * SIZE, 3), 200, np.uint8), depth, np.eye(4))


def drawn(ring: RingScan) -> FloatArray:
    """The drawing of a scan of whose room nothing is predicted."""
    layout = CompletedLayout(
        np.eye(4),
        np.full((5, CELLS, CELLS), 0.2, np.float32),
        np.zeros((CELLS, CELLS), np.uint8),
        np.zeros((0, 0, 0), np.float32),
        np.full((CELLS, CELLS), 0.2, np.float32),
        np.zeros((CELLS, CELLS), bool),
        np.array([0.0, 0.0, 1.0, -1.4]),
    )
    return draw(ring, layout).channels


def lab(colour: Array) -> Array:
    """Of one RGB colour, in the drawing's scale."""
    found = cv2.cvtColor(np.float32(colour)[None, None] / 255.0, cv2.COLOR_RGB2LAB)[0, 0]
    return np.asarray((found - [50.0, 0.0, 0.0]) / 40.0)


def test_a_drawing_shows_wall_table_and_floor() -> None:
    channels = drawn(wall())
    row = round((4.0 - 2.0) / CELL_M)
    assert channels[EYE].max() == 1.0
    assert set(np.flatnonzero(channels[EYE].any(axis=1))) <= {row - 1, row}
    assert channels[TABLE].max() == channels[FLOOR].max() == 0.0
    assert channels[TOP].max() == pytest.approx((1.4 + 2.0) / 2.0, abs=0.05)


def test_a_plain_wall_is_even_and_a_striped_one_is_not() -> None:
    plain, striped = wall(), wall().colour.copy()
    striped[:, ::2] = 100
    channels, uneven = drawn(plain), drawn(replace(plain, colour=striped))[UNEVEN]
    there = channels[EYE] == 1.0
    assert channels[UPRIGHT_COLOURS.start][there] == pytest.approx(lab([200] * 3)[0], abs=1e-3)
    assert channels[UNEVEN].max() < 1e-3
    assert uneven[there].mean() > 0.2


def test_floor_and_walls_have_colours_of_their_own() -> None:
    room = box_room(0, views=1, size=SIZE)
    channels = drawn(RingScan(room.colour[0], room.measured[0], np.eye(4)))
    floor = channels[LEVEL_COLOURS][:, channels[FLOOR] == 1.0]
    walls = channels[UPRIGHT_COLOURS][:3, channels[ABOVE] == 1.0]
    np.testing.assert_allclose(np.median(floor, axis=1), lab(COLOURS[2]), atol=0.02)
    np.testing.assert_allclose(np.median(walls, axis=1), lab(COLOURS[1]), atol=0.02)
