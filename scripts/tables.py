"""The few-view benchmark as Markdown."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

Json = dict[str, Any]


def markdown(settings: Json, summary: Json) -> str:
    """Tables per scene and kind of sets, then the probabilities."""
    parts = [_settings(settings)]
    scans, pairs = summary["scans"], summary["pairs"]
    for scene, kind in dict.fromkeys((g["scene"], g["kind"]) for g in scans):
        here = [g for g in scans if (g["scene"], g["kind"]) == (scene, kind)]
        parts += _scene(scene, kind, here)
        told = [g for g in pairs if (g["scene"], g["kind"]) == (scene, kind) and g["recall"]]
        if told:
            parts += ["Pairs by true overlap: recall@1 / @5 at 15 deg / 0.3 m", _pairs(told)]
    probabilities = _calibrations(summary["calibration"])
    if probabilities:
        parts += ["## Probabilities", "Of placed scans, and of pose candidates", probabilities]
    return "\n\n".join(parts) + "\n"


def _settings(settings: Json) -> str:
    told = [f"Sets drawn with seed {settings['seed']}", f"{settings['jobs']} jobs"]
    if settings["roll"] == "half":
        told.append("half of the images turned by 90, 180 or 270 degrees")
    if settings["fewview_options"]:
        told.append("fewview with " + " ".join(settings["fewview_options"]))
    return "; ".join(told) + "."


def _scene(scene: str, kind: str, groups: Sequence[Json]) -> list[str]:
    sets = dict(sorted({g["size"]: g["sets"] for g in groups}.items()))
    counts = ", ".join(f"{count} of {size} scans" for size, count in sets.items())
    parts = [
        f"## {scene}, {kind} sets ({counts})",
        "Mean rotation deg / translation m (share of scans within 15 deg / 0.3 m)",
        _by_size(groups, list(sets), _errors),
        "Unplaced of all scans; largest groups of scans that agree; wrong scans with a probability "
        "above 0.5; failed runs",
        _by_size(groups, list(sets), _left_out),
    ]
    timed = [g for g in groups if g["wall_s"] is not None]
    if timed:
        parts.append("Wall s / CPU s of a set, peak MB [wall, CPU relative to the peer to beat]")
        parts.append(_by_size(timed, list(sets), _cost))
    staged = [g for g in timed if g["timings_s"]]
    if staged:
        parts.append("Wall s by stage")
        parts.append(_by_size(staged, list(sets), _stages))
    return parts


def _by_size(groups: Sequence[Json], sizes: Sequence[int], cell: Callable[[Json], str]) -> str:
    rows = []
    for method in dict.fromkeys(g["method"] for g in groups):
        found = {g["size"]: g for g in groups if g["method"] == method}
        rows.append([method, *(cell(found[n]) if n in found else "-" for n in sizes)])
    return _table(["method", *map(str, sizes)], rows)


def _pairs(groups: Sequence[Json]) -> str:
    classes = {name: c["count"] for g in groups for name, c in g["recall"].items()}
    rows = []
    for group in groups:
        cells = [
            f"{group['recall'][name]['@1']:.2f} / {group['recall'][name]['@5']:.2f}"
            for name in classes
        ]
        rows.append([group["method"], *cells, f"{group['selected_right']} of {group['selected']}"])
    names = [f"{name} ({count})" for name, count in classes.items()]
    return _table(["method", *names, "selected right"], rows)


def _calibrations(groups: Sequence[Json]) -> str:
    rows = [
        [group["scene"], group["method"], what, str(found["count"]), f"{found['ece']:.3f}", curve]
        for group in groups
        for what in ("scans", "candidates")
        if (found := group[what]) is not None and (curve := _curve(found["bins"]))
    ]
    head = ["scene", "method", "of", "answers", "calibration error", "said: right (answers)"]
    return _table(head, rows) if rows else ""


def _curve(bins: Sequence[Json]) -> str:
    return ", ".join(f"{b['probability']:.2f}: {b['right']:.2f} ({b['count']})" for b in bins)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _errors(group: Json) -> str:
    return f"{group['rotation_deg']:.1f} / {group['translation_m']:.3f} ({group['within']:.2f})"


def _left_out(group: Json) -> str:
    return (
        f"{group['unplaced']} of {group['scans']}; {group['agreeing']}; "
        f"{group['confidently_wrong']}; {group['failures']}"
    )


def _cost(group: Json) -> str:
    told = f"{group['wall_s']:.1f} / {group['cpu_s']:.1f}, {group['peak_mb']:.0f}"
    ratio = group["ratio_to_peer"]
    return told if ratio is None else f"{told} [{ratio['wall_s']:.2f}, {ratio['cpu_s']:.2f}]"


def _stages(group: Json) -> str:
    return ", ".join(f"{stage} {seconds:.1f}" for stage, seconds in group["timings_s"].items())
