"""Fine-to-Coarse on registered neighbours in the scan order."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from benchmark.backends.fine_to_coarse import fine_to_coarse
from benchmark.methods.interface import Answer, Placement
from fewview.types import Frame


def solve(
    names: Sequence[str],
    frame: Callable[[int], Frame],
    answers: Mapping[tuple[int, int], Answer],
) -> list[Placement | None]:
    """A pose for every scan: this method leaves none out.

    Args:
        names: of the scans, in the order in which they were taken.
        frame: pixels by index.
        answers: by neighbouring indices (i, i + 1).
    """
    local = {pair: a.candidates[0] for pair, a in answers.items() if a.candidates}
    poses = fine_to_coarse([frame(i) for i in range(len(names))], local)
    return [Placement(0, pose) for pose in poses]
