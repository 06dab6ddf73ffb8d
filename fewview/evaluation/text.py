"""The scores of a report as lines for a terminal."""

from __future__ import annotations

from typing import Any

Json = dict[str, Any]


def text(scores: Json) -> str:
    """Print the result of `evaluate_report`: totals, scans, pairs, calibration."""
    parts = [_absolute(scores["absolute"]), _scans(scores["scans"])]
    if scores["pairs"]:
        parts.append(_pairs(scores["pair_summary"]))
    for what, found in scores["calibration"].items():
        if found is not None:
            parts.append(_calibration(what, found))
    return "\n\n".join(parts)


def _absolute(total: Json) -> str:
    return (
        f"{total['scans']} scans, {total['unplaced']} unplaced, {total['components']} components\n"
        f"mean error {total['rotation_deg']:.2f} deg / {total['translation_m']:.3f} m, "
        f"{total['within']:.0%} within 15 deg / 0.3 m\n"
        f"{total['agreeing']} agree with each other, "
        f"{total['confidently_wrong']} wrong with a probability above 0.5"
    )


def _scans(rows: list[Json]) -> str:
    width = max(len(row["name"]) for row in rows)
    lines = [f"{'scan':<{width}}     deg       m  prob"]
    for row in rows:
        note = "" if row["right"] else "  wrong" if row["placed"] else "  unplaced"
        lines.append(
            f"{row['name']:<{width}} {row['rotation_deg']:7.2f} {row['translation_m']:7.3f}"
            f"  {_probability(row['probability'])}{note}"
        )
    return "\n".join(lines)


def _pairs(summary: Json) -> str:
    groups = {"all pairs": summary, **summary["by_overlap"]}
    lines = ["pairs         count  none  recall@1 @3   @5    top-1 deg/m    selected right"]
    for name, group in groups.items():
        recall = "  ".join(f"{value:.2f}" for value in group["recall"].values())
        top = group["top"]["1"]
        lines.append(
            f"{name:<13} {group['count']:5} {group['without_candidates']:5}  {recall}"
            f"  {top['rotation_deg']:6.1f} / {top['translation_m']:.2f}"
            f"  {group['selected_right']:4} of {group['selected']}"
        )
    return "\n".join(lines)


def _calibration(what: str, found: Json) -> str:
    lines = [f"probabilities of {found['count']} {what}: calibration error {found['ece']:.3f}"]
    for group in found["bins"]:
        lines.append(
            f"  {group['low']:.1f}-{group['high']:.1f}: said {group['probability']:.2f}, "
            f"right {group['right']:.2f} ({group['count']})"
        )
    return "\n".join(lines)


def _probability(value: float | None) -> str:
    return "   -" if value is None else f"{value:.2f}"
