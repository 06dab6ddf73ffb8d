"""fewview's global stage on the top-K candidates of every pair."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from benchmark.methods.interface import Answer, Placement
from benchmark.methods.ours import SEED, Detail
from fewview import global_stage
from fewview.config import Config
from fewview.types import Frame, Levelling


def solve(
    names: Sequence[str],
    frame: Callable[[int], Frame],
    answers: Mapping[tuple[int, int], Answer],
    top_k: int,
) -> list[Placement | None]:
    """Placements of all scans from the first ``top_k`` candidates of every pair.

    Args:
        names: of the scans.
        frame: pixels by index, not looked at.
        answers: of `benchmark.methods.ours.Ours` by indices (source, target).
        top_k: candidates a pair hands on.
    """
    details: dict[tuple[int, int], Detail] = {
        pair: answer.detail for pair, answer in answers.items()
    }
    pairs = [
        replace(d.result, source=i, target=j, candidates=d.result.candidates[:top_k])
        for (i, j), d in details.items()
    ]
    solution = global_stage.solve(
        names, _levellings(len(names), details), pairs, Config().global_stage, SEED
    )
    return [
        None
        if p.component is None or p.world_T_scan is None
        else Placement(p.component, p.world_T_scan, p.probability)
        for p in solution.placements
    ]


def _levellings(count: int, details: Mapping[tuple[int, int], Detail]) -> list[Levelling]:
    found: dict[int, Levelling] = {}
    for (i, j), detail in details.items():
        found[i], found[j] = detail.source, detail.target
    return [found[i] for i in range(count)]
