"""Poses under which two completed rooms lie over each other, by the trained aligner."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from fewview import weights
from fewview.alignment.drawing import Drawing
from fewview.alignment.network import (
    SHIFTS,
    STEP_M,
    YAWS,
    AlignerNetwork,
    AlignerNetworkConfig,
    Spectra,
    shifts,
)
from fewview.geometry import se3
from fewview.types import Array, FloatArray

NAME = "aligner"
QUARTER = np.pi / 2
PEAK_RADIUS = 2
MAX_YAW = float(np.radians(20.0))
NEAR_SPREADS = 3.0
"""How many times the spread poses look around themselves."""
TINY = 1e-30
NEVER = -20.0
"""Logarithm of the probability of poses that the aligner cannot express."""


@dataclass(frozen=True)
class Embedded:
    """A scan from above and its embedding; see `AlignerNetwork`."""

    drawing: Drawing
    spectra: Spectra


@dataclass(frozen=True)
class RoomPoses:
    """Levelled poses of a pair, best first.

    Attributes:
        target_T_source: (K, 4, 4).
        log_mass: (K,) logarithm of the probability that lies around each.
    """

    target_T_source: Array
    log_mass: Array


@cache
def shipped_network() -> AlignerNetwork:
    """The network with the weights that come with the package.

    Raises:
        FewviewError: they are missing or damaged.
    """
    return weights.shipped(NAME, aligner_of)


def aligner_of(size: Mapping[str, Any]) -> AlignerNetwork:
    """The network of a card's sizes."""
    return AlignerNetwork(AlignerNetworkConfig(**size))


def embed(drawing: Drawing, network: AlignerNetwork | None = None) -> Embedded:
    """What pairs need of one scan; the shipped network when none is given."""
    network = shipped_network() if network is None else network
    with torch.inference_mode():
        return Embedded(drawing, network(torch.from_numpy(drawing.channels)[None]))


class Alignment:
    """The probability of every levelled pose of a pair."""

    def __init__(
        self, source: Embedded, target: Embedded, network: AlignerNetwork | None = None
    ) -> None:
        network = shipped_network() if network is None else network
        with torch.inference_mode():
            logits = network.logits(source.spectra.source, target.spectra.target)[0, 0]
        self.source, self.target = source.drawing, target.drawing
        chance = logits.flatten().softmax(dim=0).view_as(logits)
        self.mass: FloatArray = _around(chance).numpy()
        self.yaws: FloatArray = chance.sum(dim=(1, 2)).numpy()

    def best(self, count: int) -> RoomPoses:
        """The ``count`` poses with most probability around them, none within another's
        neighbourhood."""
        left = self.mass.copy()
        poses, found = [], []
        for _ in range(count):
            yaw, row, column = np.unravel_index(int(left.argmax()), left.shape)
            found.append(float(left[yaw, row, column]))
            shift = self._peak(int(yaw), int(row), int(column))
            poses.append(pose_of(self.source, self.target, int(yaw) * QUARTER, shift))
            rows, columns = (_near(int(index)) for index in (row, column))
            left[yaw][np.ix_(rows, columns)] = 0.0
        return RoomPoses(np.stack(poses), np.log(np.maximum(found, np.exp(NEVER))))

    def log_mass(self, target_T_source: Array) -> Array:
        """(K,) logarithm of the probability around (K, 4, 4) poses, `NEVER` where the walls of
        the scans are not parallel or the shift is beyond reach."""
        motion = planar_motion(self.source, self.target, target_T_source)
        turns = np.rint(motion[:, 0] / QUARTER)
        index = np.rint(-motion[:, 1:] / STEP_M).astype(np.int64)
        known = np.abs(motion[:, 0] - turns * QUARTER) < MAX_YAW
        known &= (np.abs(index) < SHIFTS // 2).all(axis=1)
        row, column = np.where(known[:, None], index, 0).T % SHIFTS
        mass = self.mass[turns.astype(np.int64) % YAWS, row, column]
        return np.where(known, np.log(np.maximum(mass, np.exp(NEVER))), NEVER)

    def log_yaw(self, target_T_source: Array) -> Array:
        """(K,) logarithm of the probability of the yaws of (K, 4, 4) poses, whatever the shift."""
        motion = planar_motion(self.source, self.target, target_T_source)
        turns = np.rint(motion[:, 0] / QUARTER).astype(np.int64) % YAWS
        return np.asarray(np.log(np.maximum(self.yaws[turns], np.exp(NEVER))), dtype=np.float64)

    def near(self, target_T_source: Array, spread_m: float) -> Array:
        """Levelled poses (K, 4, 4) near (K, 4, 4) ones: with the nearest quarter turn as their yaw,
        and the mean shift under the probability of that yaw times a Gaussian of ``spread_m`` around
        the shift."""
        motion = planar_motion(self.source, self.target, target_T_source).astype(np.float64)
        turns, start = np.rint(motion[:, 0] / QUARTER).astype(np.int64), motion[:, 1:, None]
        reach = int(NEAR_SPREADS * spread_m / STEP_M)
        cells = np.rint(-start / STEP_M).astype(np.int64) + np.arange(-reach, reach + 1)
        shift = -STEP_M * cells
        rows, columns = (cells % SHIFTS).swapaxes(0, 1)
        mass = self.mass[turns[:, None, None] % YAWS, rows[:, :, None], columns[:, None, :]]
        within = np.abs(cells) < SHIFTS // 2
        mass = np.where(within[:, 0, :, None] & within[:, 1, None, :], mass, 0.0)
        bell = np.exp(-0.5 * ((shift - start) / spread_m) ** 2)
        weight = np.maximum(mass, TINY) * bell[:, 0, :, None] * bell[:, 1, None, :]
        along = [weight.sum(axis=2), weight.sum(axis=1)]
        mean = [
            (w * s).sum(axis=1) / w.sum(axis=1)
            for w, s in zip(along, shift.swapaxes(0, 1), strict=True)
        ]
        poses = [
            pose_of(self.source, self.target, turn * QUARTER, at)
            for turn, at in zip(turns, np.stack(mean, axis=1), strict=True)
        ]
        return np.array(poses).reshape(-1, 4, 4)

    def _peak(self, yaw: int, row: int, column: int) -> Array:
        """The centre of the probability around a cell, metres."""
        rows, columns = _near(row), _near(column)
        weight = self.mass[yaw][np.ix_(rows, columns)].astype(np.float64)
        weight /= weight.sum()
        step = np.arange(-PEAK_RADIUS, PEAK_RADIUS + 1)
        off = np.array([weight.sum(axis=1) @ step, weight.sum(axis=0) @ step])
        at = shifts().numpy().astype(np.float64)
        return np.array([at[row], at[column]]) - STEP_M * off


def pose_of(source: Drawing, target: Drawing, yaw: float, shift: Array) -> Array:
    """target_T_source (4, 4) of a yaw and a shift (2,) of grid frames with one common floor."""
    level = se3.pose(
        se3.rotation_exp(np.array([0.0, 0.0, yaw])),
        np.array([*shift, target.floor_z - source.floor_z]),
    )
    return se3.inverse(target.level_T_scan) @ level @ source.level_T_scan


def planar_motion(source: Drawing, target: Drawing, target_T_source: Array) -> FloatArray:
    """(K, 3) yaw and shift (x, y) between the grids' frames under (K, 4, 4) poses."""
    level = target.level_T_scan @ target_T_source @ se3.inverse(source.level_T_scan)
    turn = level[:, :2, :2]
    yaw = np.arctan2(turn[:, 1, 0] - turn[:, 0, 1], turn[:, 0, 0] + turn[:, 1, 1])
    return np.concatenate([yaw[:, None], level[:, :2, 3]], axis=1).astype(np.float32)


def _around(chance: Tensor) -> Tensor:
    """Sums over 3 x 3 shifts, around the edges."""
    padded = torch.nn.functional.pad(chance[None], (1, 1, 1, 1), mode="circular")
    return 9.0 * torch.nn.functional.avg_pool2d(padded, 3, stride=1)[0]


def _near(index: int) -> np.ndarray:
    return np.arange(index - PEAK_RADIUS, index + PEAK_RADIUS + 1) % SHIFTS
