"""Every scan where the first one stands."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from benchmark.methods.interface import Answer, Placement
from fewview.types import Frame


def solve(
    names: Sequence[str],
    frame: Callable[[int], Frame],
    answers: Mapping[tuple[int, int], Answer],
) -> list[Placement | None]:
    """The identity for all scans, whatever the pairs say."""
    return [Placement(0, np.eye(4)) for _ in names]
