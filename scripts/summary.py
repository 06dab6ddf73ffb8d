"""Means over the rows of the few-view benchmark, and their Markdown tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fewview.evaluation.calibration import expected_calibration_error

Json = dict[str, Any]
MEASURES = ("wall_s", "cpu_s", "peak_mb")


def summarise(rows: Sequence[Json], peer: str) -> list[Json]:
    """One entry per scene, kind, size and method; ratios are against ``peer`` on the same sets."""
    keys = dict.fromkeys((r["scene"], r["kind"], r["size"], r["method"]) for r in rows)
    groups = [_group(key, [r for r in rows if _key(r) == key]) for key in keys]
    by_key = {(g["scene"], g["kind"], g["size"], g["method"]): g for g in groups}
    for group in groups:
        other = by_key.get((group["scene"], group["kind"], group["size"], peer))
        group["ratio_to_peer"] = _ratios(group, other) if other else None
    return groups


def markdown(results: Json) -> str:
    """Tables per scene and kind: errors, scans left out, time and memory, probabilities."""
    groups = results["groups"]
    parts = [_settings(results["settings"])]
    for scene, kind in dict.fromkeys((g["scene"], g["kind"]) for g in groups):
        here = [g for g in groups if (g["scene"], g["kind"]) == (scene, kind)]
        sizes = sorted({g["size"] for g in here})
        counts = ", ".join(
            f"{next(g['sets'] for g in here if g['size'] == n)} of {n} scans" for n in sizes
        )
        parts.append(f"## {scene}, {kind} sets ({counts})")
        parts.append("Mean rotation deg / translation m (share of scans within 15 deg / 0.3 m)")
        parts.append(_table(here, sizes, _errors))
        parts.append(
            "Unplaced scans; scans that agree with each other; confidently wrong; failures"
        )
        parts.append(_table(here, sizes, _left_out))
        timed = [g for g in here if g["wall_s"] is not None]
        if timed:
            parts.append(
                "Wall s / CPU s a set, peak MB [wall and CPU relative to the peer to beat]"
            )
            parts.append(_table(timed, sizes, _cost))
    parts.append(_calibrations(groups))
    return "\n\n".join(part for part in parts if part) + "\n"


def _key(row: Json) -> tuple[str, str, int, str]:
    return row["scene"], row["kind"], row["size"], row["method"]


def _group(key: tuple[str, str, int, str], rows: Sequence[Json]) -> Json:
    totals = [row["scores"]["absolute"] for row in rows]
    group: Json = dict(zip(("scene", "kind", "size", "method"), key, strict=True))
    group["sets"] = len(rows)
    group["failures"] = sum(row["failed"] is not None for row in rows)
    for name in ("rotation_deg", "translation_m", "within"):
        group[name] = float(np.mean([total[name] for total in totals]))
    for name in ("scans", "unplaced", "agreeing", "confidently_wrong"):
        group[name] = sum(total[name] for total in totals)
    for name in MEASURES:
        values = [row["measured"][name] for row in rows if row["measured"]]
        group[name] = float(np.mean(values)) if values else None
    for what in ("scans", "candidates"):
        group[f"{what}_calibration"] = _calibration(rows, what)
    return group


def _calibration(rows: Sequence[Json], what: str) -> Json | None:
    """Calibration error of all probabilities of a group together."""
    told = [answer for row in rows for answer in _answers(row, what)]
    if not told:
        return None
    probability = np.array([answer["probability"] for answer in told])
    right = np.array([answer["right"] for answer in told])
    ece = expected_calibration_error(probability, right)
    return {"count": len(told), "ece": ece, "brier": float(np.mean((probability - right) ** 2))}


def _answers(row: Json, what: str) -> list[Json]:
    if what == "scans":
        answers = [scan for scan in row["scores"]["scans"] if scan["placed"]]
    else:
        answers = [c for pair in row["scores"]["pairs"] for c in pair["candidates"]]
    return [answer for answer in answers if answer["probability"] is not None]


def _ratios(group: Json, other: Json) -> Json:
    names = ("rotation_deg", "translation_m", *MEASURES)
    return {n: group[n] / other[n] if group[n] is not None and other[n] else None for n in names}


def _settings(settings: Json) -> str:
    roll = (
        "half of the images turned by 90, 180 or 270 degrees" if settings["roll"] == "half" else ""
    )
    told = [f"Sets drawn with seed {settings['seed']}", f"{settings['jobs']} jobs", roll]
    if settings["fewview_options"]:
        told.append("fewview with " + " ".join(settings["fewview_options"]))
    return "; ".join(part for part in told if part) + "."


def _table(groups: Sequence[Json], sizes: Sequence[int], cell: Any) -> str:
    lines = [
        "| method | " + " | ".join(str(n) for n in sizes) + " |",
        "|---" * (len(sizes) + 1) + "|",
    ]
    for method in dict.fromkeys(g["method"] for g in groups):
        found = {g["size"]: g for g in groups if g["method"] == method}
        cells = [cell(found[n]) if n in found else "-" for n in sizes]
        lines.append(f"| {method} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


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


def _calibrations(groups: Sequence[Json]) -> str:
    lines = []
    for group in groups:
        for what in ("scans", "candidates"):
            found = group[f"{what}_calibration"]
            if found is not None:
                where = f"{group['scene']} {group['kind']} {group['size']} {group['method']}"
                lines.append(f"| {where} | {what} | {found['count']} | {found['ece']:.3f} |")
    if not lines:
        return ""
    head = [
        "## Probabilities",
        "",
        "| sets | of | answers | calibration error |",
        "|---|---|---|---|",
    ]
    return "\n".join([*head, *lines])
