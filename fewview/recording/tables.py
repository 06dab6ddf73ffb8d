"""The answer of a run as Markdown: scans, pairs, candidates, timings."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

from fewview.recording.rooms import RoomShape
from fewview.types import (
    Alternative,
    GlobalSolution,
    PairResult,
    PoseCandidate,
    ScanPlacement,
    ScanSet,
)


def inputs(scans: ScanSet) -> str:
    """What was read."""
    unit = f"{scans.depth_unit_m:g} m per depth value"
    rows = (
        (
            s.name,
            f"{s.intrinsics.width} x {s.intrinsics.height}",
            f"{s.intrinsics.fx:.1f}",
        )
        for s in scans.scans
    )
    table = _table(("scan", "pixels", "focal length"), rows)
    notes = "".join(f"\n- {escaped(note)}" for note in scans.notes)
    return f"# {len(scans.scans)} scans ({escaped(scans.format)}, {unit})\n{notes}\n\n{table}"


def answer(solution: GlobalSolution) -> str:
    """Which scans were placed, how surely, and why the others were not."""
    parts = [f"# {solution.headline}"]
    parts += [_component(i, solution) for i in range(len(solution.components))]
    unplaced = [p for p in solution.placements if not p.placed]
    if unplaced:
        rows = ((p.name, _percent(p.probability)) for p in unplaced)
        parts += ["## Not placed", _table(("scan", "probability"), rows)]
        parts += [f"**{escaped(p.name)}**: {escaped(p.reason)}" for p in unplaced if p.reason]
    if solution.alternatives:
        other = ((_moved(a, solution), f"{a.odds:.2f}") for a in solution.alternatives)
        parts += ["## Other answers", _table(("scans that could stand otherwise", "odds"), other)]
    return "\n\n".join(parts)


def candidates(
    names: Sequence[str],
    pairs: Iterable[PairResult],
    selected: Mapping[tuple[int, int], int],
) -> str:
    """All candidates of all pairs; the selected one of a pair is marked."""
    rows: list[tuple[str, ...]] = []
    for pair in pairs:
        title = f"{names[pair.source]} - {names[pair.target]}"
        chosen = selected.get((pair.source, pair.target))
        rows += [(title, *_candidate(c, c.rank == chosen)) for c in pair.candidates]
        if not pair.candidates:
            blank = ("",) * (len(_CANDIDATE) - 1)
            rows.append((title, *blank, pair.reason or pair.status.value))
    return _table(("pair", *_CANDIDATE), rows)


def rooms(shapes: Mapping[str, RoomShape]) -> str:
    """How completed rooms are drawn, and their walls; empty where nothing was completed."""
    rows = [
        (name, str(shape.walls(observed=True)), str(shape.walls(observed=False)), f"{height:.2f} m")
        for name, shape in shapes.items()
        if (height := shape.height) is not None
    ]
    head = ("scan", "walls seen", "walls predicted", "floor to ceiling")
    table = [_table(head, rows)] if rows else []
    drawn = any(len(shape.vertices) for shape in shapes.values())
    return "\n\n".join(["## Rooms", _ROOMS_KEY, *table]) if drawn else ""


def timings(timings_s: Mapping[str, float]) -> str:
    """Wall seconds per stage, as rows to append to the answer."""
    total = sum(timings_s.values())
    rows = [
        (stage, f"{s:.2f}", _percent(s / total if total else 0)) for stage, s in timings_s.items()
    ]
    return "## Time\n\n" + _table(("stage", "seconds", "share"), rows)


def escaped(text: str) -> str:
    """Text that Markdown shows as it is, on one line."""
    return re.sub(r"([\\`*_{}\[\]<>|#~])", r"\\\1", " ".join(text.split()))


_ROOMS_KEY = (
    "What networks make of the surroundings of each scan. Pictures: each ring as seen above the "
    "same ring completed; layouts from above, what was seen in full colours, the rest pale. "
    "In space: planes that a scan shows are green, predicted ones orange; predicted points have "
    "the colours of their classes."
)
_WORLDS = {
    "floor": "floor at z = 0",
    "gravity": "z up, first scan at the origin",
    "given": "in the frame of the fixed poses",
}
_CANDIDATE = (
    "rank",
    "probability",
    "score",
    "residual",
    "overlap",
    "violation",
    "origin",
    "support",
)


def _candidate(candidate: PoseCandidate, chosen: bool) -> tuple[str, ...]:
    evidence = candidate.evidence
    support = ", ".join(f"{n} {kind}" for kind, n in evidence.support.items() if n)
    return (
        f"{candidate.rank} selected" if chosen else str(candidate.rank),
        _percent(candidate.probability),
        f"{candidate.score:.3g}",
        f"{100 * evidence.residual_m:.1f} cm",
        _percent(evidence.overlap),
        _percent(evidence.free_space_violation),
        candidate.origin.value,
        support,
    )


def _moved(alternative: Alternative, solution: GlobalSolution) -> str:
    return ", ".join(solution.placements[place.scan].name for place in alternative.places)


def _component(index: int, solution: GlobalSolution) -> str:
    component = solution.components[index]
    frame = _WORLDS[component.world]
    link = (
        f"Best rejected link: {escaped(component.nearest_link)}." if component.nearest_link else ""
    )
    members = [solution.placements[i] for i in component.scans]
    rows = (_placement(p) for p in members)
    table = _table(("scan", "probability", "position (m)"), rows)
    return f"## Component {index}: {len(members)} scans, {frame}\n\n{link}\n\n{table}"


def _placement(placement: ScanPlacement) -> tuple[str, ...]:
    pose = placement.world_T_scan
    position = "" if pose is None else ", ".join(f"{x:.2f}" for x in pose[:3, 3])
    return placement.name, _percent(placement.probability), position


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [
        head,
        ["---"] * len(head),
        *([escaped(cell) for cell in row] for row in rows),
    ]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
