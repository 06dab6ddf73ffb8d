"""What the training loop needs to know of a network, and the problems there are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from torch import Tensor, nn

from fewview.errors import ConfigError

if TYPE_CHECKING:
    from fewview.training.rooms import RoomSource

Batch = dict[str, Tensor]
Room = Any
"""A `RoomSample` or what a problem makes of one: arrays whose first axis counts the views."""
PROBLEMS: Mapping[str, tuple[str, str]] = {
    "aligner": ("fewview.training.aligner", "AlignerProblem"),
    "joint": ("fewview.training.joint", "JointProblem"),
    "layout": ("fewview.training.layout", "LayoutProblem"),
    "panorama": ("fewview.training.panorama", "PanoramaProblem"),
    "relation": ("fewview.training.relation", "RelationProblem"),
    "structure": ("fewview.training.structure", "StructureProblem"),
    "verifier": ("fewview.training.verifier", "VerifierProblem"),
}
"""Name -> module and class."""


class Problem(Protocol):
    """One network and what it is to learn: a frozen dataclass whose fields are its settings."""

    @property
    def name(self) -> str:
        """Of the weights."""

    def network(self) -> nn.Module:
        """The network with weights drawn from torch's generator."""

    def prepared(self, rooms: RoomSource) -> RoomSource:
        """A source of what `batch` is given of every room."""
        return rooms

    def preparation(self) -> str:
        """Fingerprint of what `prepared` does, empty where it does nothing."""
        return ""

    def mirrored(self, room: Room) -> Room:
        """A prepared room with left and right exchanged."""
        from fewview.training.rooms import mirrored

        return mirrored(room)

    def batch(self, rooms: Sequence[Room], rng: np.random.Generator) -> Batch:
        """What the network sees of some rooms and the truth about them; made in a worker."""

    def losses(self, network: nn.Module, batch: Batch) -> dict[str, Tensor]:
        """Weighted parts of what is minimised, scalars."""

    def metrics(self, network: nn.Module, batch: Batch) -> dict[str, float]:
        """Figures for people; not a number where a batch has nothing to measure."""


def make(name: str) -> Problem:
    """A problem with its default settings.

    Raises:
        ConfigError: there is no such problem.
    """
    if name not in PROBLEMS:
        raise ConfigError(f"unknown problem '{name}'; there are {', '.join(sorted(PROBLEMS))}")
    module, kind = PROBLEMS[name]
    problem: Problem = getattr(import_module(module), kind)()
    return problem
