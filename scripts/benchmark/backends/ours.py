"""fewview's global stage on the top-K candidates of every pair."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from benchmark.methods.interface import Answer, Placement
from benchmark.methods.ours import SEED, Detail
from fewview import global_stage
from fewview.config import Config
from fewview.executor import single_threaded_libraries
from fewview.matching.prepared import PreparedScan
from fewview.together import Together
from fewview.types import Frame


def solve(
    names: Sequence[str],
    frame: Callable[[int], Frame],
    answers: Mapping[tuple[int, int], Answer],
    views: Sequence[PreparedScan],
    top_k: int,
    together: bool = True,
) -> list[Placement | None]:
    """Placements of all scans from the first ``top_k`` candidates of every pair.

    Args:
        names: of the scans.
        frame: pixels by index, not looked at.
        answers: of `benchmark.methods.ours.Ours` by indices (source, target).
        views: the prepared scans.
        top_k: candidates a pair hands on.
        together: let all scans judge what candidates leave open, where rooms are completed.
    """
    details: dict[tuple[int, int], Detail] = {
        pair: answer.detail for pair, answer in answers.items()
    }
    pairs = [
        replace(d.result, source=i, target=j, candidates=d.result.candidates[:top_k])
        for (i, j), d in details.items()
    ]
    config, scans = Config().global_stage, [view.scan for view in views]
    foreseen = together and all(scan.room.layout is not None for scan in scans)
    with single_threaded_libraries():
        solution = global_stage.solve(
            names,
            [scan.levelling for scan in scans],
            pairs,
            config,
            SEED,
            potentials=Together(views.__getitem__) if foreseen else None,
        )
        pairs = list(solution.with_found(pairs))
        solution = global_stage.refine(solution, pairs, scans, config)
    return [
        None
        if p.component is None or p.world_T_scan is None
        else Placement(p.component, p.world_T_scan, p.probability)
        for p in solution.placements
    ]
