"""What a relative-pose method takes and gives: the one signature that all of them have."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from fewview.types import Array, Frame


@dataclass(frozen=True)
class Candidate:
    """One relative pose.

    Attributes:
        target_T_source: (4, 4), metres.
        score: the method's own, the higher the better; inliers where it counts them.
        probability: 0..1 that it is right, for methods that say so.
        overlap: share of the smaller cloud that found a neighbour, for back-ends that ask.
        information: (6, 6) of the edge as Open3D's pose graph wants it, likewise.
    """

    target_T_source: Array
    score: float = 0.0
    probability: float | None = None
    overlap: float | None = None
    information: Array | None = None


@dataclass(frozen=True)
class Answer:
    """What a method says about a pair.

    Attributes:
        candidates: best first by the method's own order; none is a failure.
        detail: anything that the method's own back-end wants to know; must pickle.
    """

    candidates: tuple[Candidate, ...] = ()
    detail: Any = None


class PairMethod(ABC):
    """A relative-pose method. ``prepare`` does what concerns one scan, ``match`` the rest.

    Both are deterministic: randomness is seeded inside them, whatever ran before.
    """

    top_k: ClassVar[int] = 1
    """How many candidates it gives at most."""

    def glance(self, frame: Frame) -> Any:
        """What `turns` needs of one frame; None for methods that take images as they are."""
        return None

    def turns(self, glances: Sequence[Any]) -> tuple[int, ...]:
        """Counter-clockwise quarter turns that bring scans seen together upright."""
        return (0,) * len(glances)

    @abstractmethod
    def prepare(self, frame: Frame, turn: int = 0) -> Any:
        """The view of one scan that `match` works on."""

    @abstractmethod
    def match(self, source: Any, target: Any) -> Answer:
        """Relative poses target_T_source of two prepared scans."""


@dataclass(frozen=True)
class Placement:
    """Where a back-end put a scan.

    Attributes:
        component: scans of one component share a world; 0 is the largest.
        world_T_scan: (4, 4) camera-to-world.
        probability: 0..1 that it is right, for methods that say so.
    """

    component: int
    world_T_scan: Array
    probability: float | None = None
