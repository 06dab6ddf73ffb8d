"""Error-recall curves of relative-pose methods, and the reliability of fewview's probabilities.

    python scripts/figure_curves.py --dataset rooms --out results/curves.json

Writes NAME-recall.png, NAME-recall-below-10.png and NAME-reliability.png beside the JSON.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.catalogue import PAIR_METHODS
from benchmark.command import (
    answered_pairs,
    method_names,
    opened,
    out_path,
    pair_list,
    pair_parser,
    settings,
)
from benchmark.curves import pose_recall, reliability_diagram
from fewview.evaluation.calibration import reliability

Json = dict[str, Any]
METHODS = "manhattan_away,4pcs,fgr,ransac_icp,kiss_icp,xfeat_icp,ours_global,ours"


def main() -> None:
    """Parse the arguments, run what is missing, draw."""
    parser = pair_parser(__doc__, "curves")
    parser.add_argument("--methods", type=method_names, default=method_names(METHODS))
    options = parser.parse_args()
    dataset = opened(options)
    pairs = pair_list(options, dataset)
    methods = [PAIR_METHODS[name] for name in options.methods]
    answered = answered_pairs(options, dataset, pairs, methods)
    rows = {method.label: answered[method.key] for method in methods}
    out = out_path(options, dataset)
    out.parent.mkdir(parents=True, exist_ok=True)
    draw_recall(rows, out.with_name(f"{out.stem}-recall.png"))
    hard = {name: [row for row in own if row["overlap"] < 0.1] for name, own in rows.items()}
    draw_recall(hard, out.with_name(f"{out.stem}-recall-below-10.png"))
    told = [c for row in answered[PAIR_METHODS["ours"].key] for c in row["candidates"]]
    bins = reliability(
        np.array([c["probability"] for c in told]), np.array([c["right"] for c in told])
    )
    reliability_diagram({"Ours": bins}, out.with_name(f"{out.stem}-reliability.png"))
    results = {**settings(options, dataset), "reliability": [vars(group) for group in bins]}
    out.write_text(json.dumps(results, indent=1, allow_nan=False) + "\n")


def draw_recall(rows: Mapping[str, Sequence[Json]], path: Path) -> None:
    """Top-1 errors; a pair without an answer is never reached."""
    rotation = {name: [_first(row, "rotation_deg") for row in own] for name, own in rows.items()}
    shift = {name: [_first(row, "translation_m") for row in own] for name, own in rows.items()}
    pose_recall(rotation, shift, path)
    print(path)


def _first(row: Json, key: str) -> float:
    return float(row["candidates"][0][key]) if row["candidates"] else np.inf


if __name__ == "__main__":
    main()
