"""Score a run's report against ground truth: scans, pairs, probabilities."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from fewview.errors import FewviewError
from fewview.evaluation.calibration import calibration_of
from fewview.evaluation.gauge import AbsoluteErrors, absolute_errors
from fewview.evaluation.pairs import Overlaps, score_pairs, summarise_pairs
from fewview.types import Array

Json = dict[str, Any]

CONFIDENT = 0.5
"""A wrong scan or candidate that claims more than this is reported as confidently wrong."""


def evaluate_report(
    report: Json,
    truth: Mapping[str, Array],
    *,
    overlaps: Overlaps | None = None,
    centroids: Mapping[str, Array] | None = None,
) -> Json:
    """Compare a report with true poses by the few-view and the pair protocol.

    The largest component is scored (by scans with truth; the lower number wins a tie); scans
    outside it count as unplaced (see `gauge.absolute_errors`).

    Args:
        report: the parsed JSON of a run.
        truth: (4, 4) camera-to-world by scan name; scans without one are left out.
        overlaps: true overlap 0..1 by pair of names in either order; splits the pair results.
        centroids: (3,) centroid of a scan's points in its own frame by name; adds the
            translation error at the source's centroid.

    Returns:
        A strict-JSON dictionary with ``absolute``, ``scans``, ``pair_summary``, ``pairs`` and
        ``calibration``; rotation in degrees, translation in metres.

    Raises:
        FewviewError: none of the report's scans has a true pose.
    """
    scans = [scan for scan in report["scans"] if scan["name"] in truth]
    if not scans:
        raise FewviewError(
            "none of the report's scans has a ground-truth pose; "
            "put NAME.pose.txt beside the images or evaluate another folder"
        )
    component = _largest_component(scans)
    errors = absolute_errors(
        np.stack([truth[scan["name"]] for scan in scans]),
        [_pose_in(scan, component) for scan in scans],
    )
    rows = _scan_rows(scans, errors)
    pairs = score_pairs(report["pairs"], truth, overlaps, centroids)
    candidates = [candidate for pair in pairs for candidate in pair["candidates"]]
    return {
        "absolute": _absolute(scans, errors),
        "scans": rows,
        "pair_summary": summarise_pairs(pairs),
        "pairs": pairs,
        "calibration": {
            "scans": calibration_of([row for row in rows if row["placed"]]),
            "candidates": calibration_of(candidates),
        },
    }


def _largest_component(scans: list[Json]) -> int | None:
    sizes = Counter(scan["component"] for scan in scans if scan["placed"])
    return max(sizes, key=lambda c: (sizes[c], -c)) if sizes else None


def _pose_in(scan: Json, component: int | None) -> Array | None:
    if not scan["placed"] or scan["component"] != component:
        return None
    return np.array(scan["world_T_scan"], dtype=np.float64)


def _absolute(scans: list[Json], errors: AbsoluteErrors) -> Json:
    claimed = np.array([(scan.get("probability") or 0.0) > CONFIDENT for scan in scans])
    return {
        "scans": len(scans),
        "rotation_deg": float(errors.rotation_deg.mean()),
        "translation_m": float(errors.translation_m.mean()),
        "within": float(errors.right.mean()),
        "unplaced": int((~errors.placed).sum()),
        "components": len({scan["component"] for scan in scans if scan["placed"]}),
        "agreeing": int(errors.agreeing.sum()),
        "confidently_wrong": int((errors.placed & ~errors.right & claimed).sum()),
    }


def _scan_rows(scans: list[Json], errors: AbsoluteErrors) -> list[Json]:
    return [
        {
            "name": scan["name"],
            "placed": bool(errors.placed[i]),
            "rotation_deg": float(errors.rotation_deg[i]),
            "translation_m": float(errors.translation_m[i]),
            "right": bool(errors.right[i]),
            "agreeing": bool(errors.agreeing[i]),
            "probability": scan.get("probability"),
        }
        for i, scan in enumerate(scans)
    ]
