"""Error-recall curves and reliability diagrams, the same bytes for the same numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from fewview.evaluation.calibration import Bin, calibration_error
from fewview.evaluation.metrics import RIGHT_DEG, RIGHT_M
from fewview.types import Array

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#000000", "#E69F00", "#56B4E9")
"""Told apart by colour-blind readers: Okabe and Ito (2008), Color Universal Design."""
DASHES = ("solid", (0, (5, 2)), (0, (1, 1.2)))
"""After the last colour, the first one again with the next dash."""
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
STYLE = {
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "font.size": 10.0,
    "grid.color": "#e3e3e3",
    "legend.frameon": False,
    "lines.linewidth": 1.8,
    "savefig.dpi": 150,
}
NORMAL_95 = 1.96


def recall_curve(errors: Sequence[float], limit: float) -> tuple[Array, Array]:
    """The share of errors that are at most x, for x from 0 to ``limit``.

    Args:
        errors: one per pair; infinite or NaN where a method failed, which is never reached.
        limit: the largest x.

    Returns:
        The corners (k,) of a step function that holds its value up to the next corner: x, share.
    """
    values = np.asarray(errors, dtype=np.float64)
    reached = np.sort(values[values <= limit])
    x = np.concatenate([[0.0], reached, [limit]])
    return x, np.searchsorted(reached, x, side="right") / max(len(values), 1)


def error_recall(
    errors: Mapping[str, Sequence[float]],
    unit: str,
    limit: float,
    path: Path,
    right: float | None = None,
) -> None:
    """Write a figure with the share of pairs whose error is at most x, one curve a method.

    Args:
        errors: of every pair by method, see `recall_curve`.
        unit: of the errors, for the axis.
        limit: the largest error shown.
        path: of the PNG.
        right: the tolerance within which an answer is right, marked when given.
    """
    with matplotlib.style.context(["default", STYLE]):
        figure = Figure(figsize=(6.6, 3.6), layout="constrained")
        axes = figure.subplots()
        _recall_panel(axes, errors, f"error ({unit})", limit, right)
        figure.legend(*axes.get_legend_handles_labels(), loc="outside right center")
        _save(figure, path)


def pose_recall(
    rotation_deg: Mapping[str, Sequence[float]],
    translation_m: Mapping[str, Sequence[float]],
    path: Path,
    limit_deg: float = 60.0,
    limit_m: float = 2.0,
) -> None:
    """Write `error_recall` of rotations and translations side by side, the same methods in both.

    The tolerances within which a pose is right are marked.
    """
    with matplotlib.style.context(["default", STYLE]):
        figure = Figure(figsize=(9.6, 3.6), layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True)
        _recall_panel(left, rotation_deg, "rotation error (degrees)", limit_deg, RIGHT_DEG)
        _recall_panel(right, translation_m, "translation error (m)", limit_m, RIGHT_M)
        right.set_ylabel("")
        figure.legend(*left.get_legend_handles_labels(), loc="outside right center")
        _save(figure, path)


def reliability_diagram(bins: Mapping[str, Sequence[Bin]], path: Path) -> None:
    """Write how often answers were right against how probable they were said to be.

    Bars are 95 % Wilson intervals of the shares (Wilson 1927), the panel below counts the answers,
    and the legend gives each method's expected calibration error (ECE).
    """
    with matplotlib.style.context(["default", STYLE]):
        figure = Figure(figsize=(6.6, 4.8), layout="constrained")
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
        upper.plot([0, 1], [0, 1], color="#999999", linewidth=1, linestyle=(0, (4, 3)))
        for i, (name, groups) in enumerate(bins.items()):
            _reliability_curve(upper, i, groups, f"{name}, ECE {calibration_error(groups):.3f}")
            _count_bars(lower, i, len(bins), groups)
        upper.set(xlim=(0, 1), ylim=(0, 1.02), ylabel="share right")
        upper.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
        lower.set(xlabel="stated probability of being right", ylabel="answers")
        figure.legend(*upper.get_legend_handles_labels(), loc="outside right center")
        _save(figure, path)


def wilson(share: float, count: int) -> tuple[float, float]:
    """The 95 % interval of a share of ``count`` > 0 trials (Wilson 1927)."""
    squared = NORMAL_95**2 / count
    middle = (share + squared / 2) / (1 + squared)
    half = math.sqrt(squared * (share * (1 - share) + squared / 4)) / (1 + squared)
    return max(middle - half, 0.0), min(middle + half, 1.0)


def _recall_panel(
    axes: Axes,
    errors: Mapping[str, Sequence[float]],
    label: str,
    limit: float,
    right: float | None,
) -> None:
    if right is not None:
        axes.axvline(right, color="#999999", linewidth=1, linestyle=(0, (4, 3)))
        axes.text(right, 1.01, f" {right:g}", color="#666666", va="bottom", ha="center")
    for i, (name, values) in enumerate(errors.items()):
        colour, dash = COLOURS[i % len(COLOURS)], DASHES[i // len(COLOURS) % len(DASHES)]
        x, share = recall_curve(values, limit)
        axes.step(x, share, where="post", color=colour, linestyle=dash, label=name)
    axes.set(xlim=(0, limit), ylim=(0, 1.02), xlabel=label, ylabel="share of pairs")
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))


def _reliability_curve(axes: Axes, index: int, bins: Sequence[Bin], label: str) -> None:
    shares = [group.right for group in bins]
    ends = [wilson(group.right, group.count) for group in bins]
    below = [max(share - low, 0.0) for share, (low, _) in zip(shares, ends, strict=True)]
    above = [max(high - share, 0.0) for share, (_, high) in zip(shares, ends, strict=True)]
    axes.errorbar(
        [group.probability for group in bins],
        shares,
        yerr=[below, above],
        color=COLOURS[index % len(COLOURS)],
        marker=MARKERS[index % len(MARKERS)],
        markersize=5,
        elinewidth=1,
        capsize=2,
        label=label,
        clip_on=False,
    )


def _count_bars(axes: Axes, index: int, methods: int, bins: Sequence[Bin]) -> None:
    """Bars of all methods side by side in every interval, their counts on top."""
    widths = [0.9 * (group.high - group.low) / methods for group in bins]
    middles = [
        (group.low + group.high) / 2 + (index - (methods - 1) / 2) * width
        for group, width in zip(bins, widths, strict=True)
    ]
    bars = axes.bar(
        middles, [group.count for group in bins], widths, color=COLOURS[index % len(COLOURS)]
    )
    if methods <= 2:
        axes.bar_label(bars, fontsize=7, color="#444444")
        axes.margins(y=0.2)


def _save(figure: Figure, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, format="png", metadata={"Software": None})
