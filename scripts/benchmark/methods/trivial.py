"""Answers that look at next to nothing; what a table's numbers must be compared with.

All but `Identity` level both scans by gravity as the surface shows it, and leave the cameras at
one place: the translation is zero. None of them ever fails; a scan without depth is taken to be
held upright.
"""

from __future__ import annotations

import zlib
from abc import abstractmethod
from dataclasses import dataclass

import numpy as np

from benchmark.methods.interface import Answer, Candidate, PairMethod
from fewview.completion.levelling import level
from fewview.completion.local_geometry import DepthView, thin_surface
from fewview.completion.patches import find_patches
from fewview.config import FeatureConfig
from fewview.geometry import se3
from fewview.types import Array, Frame, IntArray

SETTINGS = FeatureConfig()


@dataclass(frozen=True)
class Stance:
    """How a camera stood.

    Attributes:
        level_R_scan: (3, 3) into a frame with z up whose x axis runs along a wall where the scan
            shows a Manhattan frame, else where the camera looks.
        seed: a number that depends on the scan's depth alone.
    """

    level_R_scan: Array
    seed: int

    @staticmethod
    def of(frame: Frame) -> Stance:
        """Level a frame as fewview does."""
        view = DepthView.of(frame, SETTINGS.max_depth_m)
        surface = thin_surface(view, frame.colour, SETTINGS.surface_voxel_m)
        rng = np.random.default_rng(0)
        levelling = level(*find_patches(surface, SETTINGS.max_patches, rng))
        rotation = levelling.level_R_scan
        if not levelling.manhattan:
            ahead = rotation[:, 2]
            rotation = _yaw(-np.arctan2(ahead[1], ahead[0])) @ rotation
        return Stance(rotation, zlib.crc32(frame.depth.tobytes()))


class Identity(PairMethod):
    """Nothing moved."""

    def prepare(self, frame: Frame, turn: int = 0) -> None:
        """Nothing to know."""

    def match(self, source: None, target: None) -> Answer:
        """The identity, whatever the scans."""
        return Answer((Candidate(np.eye(4)),))


class _LevelledYaws(PairMethod):
    """Levels two scans and guesses the yaw between their level frames."""

    @abstractmethod
    def yaws(self, source: Stance, target: Stance) -> Array:
        """(k,) angles that turn the source's level frame into the target's, radians."""

    def order(self, target_R_source: Array, rng: np.random.Generator) -> IntArray:
        """The (k,) order in which (k, 3, 3) rotations are given; as they come by default."""
        return np.arange(len(target_R_source))

    def prepare(self, frame: Frame, turn: int = 0) -> Stance:
        """How the camera stood."""
        return Stance.of(frame)

    def match(self, source: Stance, target: Stance) -> Answer:
        """One candidate a yaw."""
        yaws = self.yaws(source, target)
        rotations = np.stack(
            [target.level_R_scan.T @ _yaw(yaw) @ source.level_R_scan for yaw in yaws.tolist()]
        )
        ordered = rotations[self.order(rotations, _rng(source, target))]
        return Answer(tuple(Candidate(se3.pose(r, np.zeros(3))) for r in ordered))


class UniformYaw(_LevelledYaws):
    """Yaws drawn from all directions alike."""

    top_k = 5

    def yaws(self, source: Stance, target: Stance) -> Array:
        """`top_k` uniform angles."""
        return _rng(source, target).uniform(0.0, 2.0 * np.pi, self.top_k)


class ManhattanRandom(_LevelledYaws):
    """The four yaws that bring the Manhattan frames together, in random order.

    A scan that shows no Manhattan frame lends its camera's heading instead.
    """

    top_k = 4

    def yaws(self, source: Stance, target: Stance) -> Array:
        """The four quarter turns."""
        return np.array([0.0, 0.5, 1.0, 1.5]) * np.pi

    def order(self, target_R_source: Array, rng: np.random.Generator) -> IntArray:
        """At random."""
        return np.asarray(rng.permutation(len(target_R_source)))


class ManhattanFacingAway(ManhattanRandom):
    """The same four, the one first in which the cameras look most apart.

    Scans of few views were made to show different parts of a room.
    """

    def order(self, target_R_source: Array, rng: np.random.Generator) -> IntArray:
        """By the angle between the viewing directions, largest first."""
        return np.asarray(np.argsort(target_R_source[:, 2, 2], kind="stable"))


def _yaw(angle: float) -> Array:
    return se3.rotation_exp(np.array([0.0, 0.0, angle]))


def _rng(source: Stance, target: Stance) -> np.random.Generator:
    return np.random.default_rng([source.seed, target.seed])
