"""fewview as a relative-pose method: whole, without one of its modules, with fewer features."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from benchmark.methods.interface import Answer, Candidate, PairMethod
from fewview.completion import complete
from fewview.completion.orientation import Glance, glance, quarter_turns
from fewview.config import Config, merge
from fewview.executor import single_threaded_libraries
from fewview.matching.prepared import PreparedScan, prepare
from fewview.pairwise import match_pair
from fewview.refinement.local import refine_alone
from fewview.types import Frame, PairResult, PairStatus

SEED = 0


@dataclass(frozen=True)
class Detail:
    """What fewview's global stage needs of a pair."""

    result: PairResult


class Ours(PairMethod):
    """``fewview pair``: top-K candidates by falling probability.

    Args:
        settings: differences from the default settings, nested as in a YAML file.
    """

    top_k: ClassVar[int] = 5

    def __init__(self, settings: dict[str, object] | None = None) -> None:
        self.config = merge(Config(), settings or {}, "benchmark")

    def glance(self, frame: Frame) -> Glance:
        with single_threaded_libraries():
            return glance(frame)

    def turns(self, glances: Sequence[Glance]) -> tuple[int, ...]:
        """As the pipeline decides for the scans of one folder."""
        return tuple(quarter_turns(list(glances)).tolist())

    def prepare(self, frame: Frame, turn: int = 0) -> PreparedScan:
        with single_threaded_libraries():
            return prepare(complete("", frame, turn, self.config.features, SEED))

    def match(self, source: PreparedScan, target: PreparedScan) -> Answer:
        try:
            with single_threaded_libraries():
                result = match_pair(source, target, (0, 1), self.config)
        except (ValueError, ArithmeticError, RuntimeError) as error:
            result = PairResult(0, 1, PairStatus.FAILED, (), str(error))
        candidates = tuple(
            Candidate(c.target_T_source, c.score, c.probability) for c in result.candidates
        )
        return Answer(candidates, Detail(result))


class OursLocal(Ours):
    """Ours-Local of the paper: the local module alone, started where both cameras coincide."""

    top_k: ClassVar[int] = 1

    def match(self, source: PreparedScan, target: PreparedScan) -> Answer:
        with single_threaded_libraries():
            poses = refine_alone(source, target, np.eye(4)[None], self.config.refinement)
        return Answer((Candidate(poses[0]),))
