"""One line for the user on what kept scans and components apart."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from fewview.types import PairResult


@dataclass(frozen=True)
class Link:
    """The candidate of a pair that would have joined two sets of scans."""

    source: int
    target: int
    probability: float

    def between(self, names: Sequence[str]) -> str:
        """``a - b``."""
        return f"{names[self.source]} - {names[self.target]}"


def best_link(pairs: Sequence[PairResult], inside: Sequence[int]) -> Link | None:
    """The most probable candidate between the scans ``inside`` and the others."""
    return max(_crossing(pairs, frozenset(inside)), key=lambda link: link.probability, default=None)


def why_unplaced(
    names: Sequence[str],
    pairs: Sequence[PairResult],
    scan: int,
    min_probability: float,
) -> str:
    """Why a scan has no pose: what is missing, and the link that nearly joined it.

    Args:
        names: of all scans.
        pairs: all pair results.
        scan: the scan without a pose.
        min_probability: what was asked for.
    """
    link = best_link(pairs, [scan])
    if link is None:
        return "no candidate pose links it to any other scan"
    shown = f"best link {link.between(names)} has probability {link.probability:.2f}"
    if link.probability < min_probability:
        return f"no pose is probable enough: {shown}"
    return f"its links contradict other links or hang on doubtful scans: {shown}"


def nearest_link(
    names: Sequence[str], pairs: Sequence[PairResult], inside: Sequence[int]
) -> str | None:
    """The rejected link that would have joined a component to scans outside it."""
    link = best_link(pairs, inside)
    return None if link is None else f"{link.between(names)}, probability {link.probability:.2f}"


def _crossing(pairs: Sequence[PairResult], inside: frozenset[int]) -> Iterator[Link]:
    """Candidates that are not ruled out."""
    for pair in pairs:
        if (pair.source in inside) != (pair.target in inside):
            for candidate in pair.candidates:
                if candidate.probability > 0.0:
                    yield Link(pair.source, pair.target, candidate.probability)
