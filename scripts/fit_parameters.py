"""Phase two of the paper's training: learn the scales that tie the modules together (Sec. 3.4).

    python scripts/fit_parameters.py [--rooms 24] [--views 8] [--validation 24] [--out FILE]

Minimises l_3 over the gammas of each kind of feature and l_4 over the alphas of the robust
regression, on pairs of generated rooms of the training split that no network has seen, and writes
start and learned values, losses, and what they change on pairs of the validation split, with a
verdict for each module. Nothing is shipped by itself: gammas are the `SCALES` of the feature kinds,
alphas are `RefinementConfig`. Networks stay as they are.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from fewview.config import Config, merge
from fewview.executor import Executor
from fewview.matching.spectral import INLIER_SCALE
from fewview.refinement.learned_relations import LearnedRelations
from fewview.synthetic import Split
from fewview.training import regression_energy, regression_loss, spectral_loss
from fewview.training.regression_energy import RegressionProblem
from parameters import judge
from parameters.learn import (
    Descent,
    Loss,
    Problem,
    Values,
    at_the_bound,
    learned,
    mean_loss,
)
from parameters.pairs import Part, ScannedRoom, rooms
from parameters.problems import regression_problems, spectral_problems

Json = dict[str, Any]

PARTS: tuple[Part, ...] = ("observed", "completed")


def main() -> None:
    """Parse the arguments, learn, judge, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rooms", type=int, default=24, help="of the training split")
    parser.add_argument("--views", type=int, default=8, help="of each room")
    parser.add_argument("--validation", type=int, default=24, help="rooms to judge by")
    parser.add_argument("--only", choices=(*PARTS, "regression"), help="one module alone")
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--rate", type=float, default=0.05)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--right",
        type=float,
        default=INLIER_SCALE,
        help="length scales up to which the true pose explains a correspondence",
    )
    parser.add_argument(
        "--off",
        type=float,
        nargs=2,
        default=(0.0, 0.0),
        metavar=("DEG", "M"),
        help="how far off the truth l_4 starts at most; 0 0, the paper's, when not given",
    )
    parser.add_argument("--jobs", type=int, help="threads that make rooms")
    parser.add_argument("--cache", type=Path, default=Path("results/parameters"))
    parser.add_argument("--out", type=Path, default=Path("results/parameters/learned.json"))
    options = parser.parse_args()
    config, executor = Config(), Executor(options.jobs)
    splits: tuple[tuple[Split, int], ...] = (
        ("train", options.rooms),
        ("validation", options.validation),
    )
    train, validation = (
        list(rooms(split, count, options.views, config, options.cache, executor))
        for split, count in splits
    )
    made = {name: value for name, value in vars(options).items() if name not in ("cache", "out")}
    report: Json = {"made": made | {"config_hash": config.hash()}}
    for part in PARTS:
        if options.only in (None, part):
            report[part] = spectral(part, train, validation, config, options)
    if options.only in (None, "regression"):
        report["regression"] = regression(train, validation, config, options)
    print(json.dumps(report, indent=1))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(report, indent=1) + "\n")


def spectral(
    part: Part,
    train: Sequence[ScannedRoom],
    validation: Sequence[ScannedRoom],
    config: Config,
    options: argparse.Namespace,
) -> Json:
    """l_3 over the gammas of one spectral pass."""
    kinds = train[0].pairs[0].candidates(part).kinds
    start = spectral_loss.gammas_of(kinds)
    problems, held_out = (spectral_problems(r, part, options.right) for r in (train, validation))
    print(f"{part}: {len(problems)} pairs, {len(held_out)} of validation", flush=True)
    values = learned(spectral_loss.spectral_loss, problems, start, descent(options))
    count = config.matching.top_k
    old = judge.spectral_hits(validation, part, kinds, count)
    new = judge.spectral_hits(validation, part, spectral_loss.with_gammas(kinds, values), count)
    return {
        "scales": list(spectral_loss.GAMMAS),
        "start": rounded(start),
        "learned": rounded(values),
        "at_the_bound": at_the_bound(start, values),
        "loss": losses(spectral_loss.spectral_loss, problems, held_out, start, values),
        "validation": judge.judged_spectral(old, new, judge.overlaps(validation)),
    }


def regression(
    train: Sequence[ScannedRoom],
    validation: Sequence[ScannedRoom],
    config: Config,
    options: argparse.Namespace,
) -> Json:
    """l_4 over the alphas."""
    predictor, settings = LearnedRelations(), config.refinement
    off, rng = tuple(options.off), np.random.default_rng(options.seed)
    problems, held_out = (
        regression_problems(r, predictor, settings, off, rng) for r in (train, validation)
    )
    scales = regression_energy.scales_of(settings)
    start = {name: scales[name] for name in regression_energy.SCALES}
    fixed = {name: scales[name] for name in regression_energy.FIXED}

    def loss(problem: RegressionProblem, values: Mapping[str, Tensor]) -> Tensor:
        return regression_loss.regression_loss(problem, {**values, **fixed})

    print(f"regression: {len(problems)} pairs, {len(held_out)} of validation", flush=True)
    values = learned(loss, problems, start, descent(options))
    changed = merge(settings, {name: float(v) for name, v in values.items()}, "learned")
    verdicts = {}
    for name, farthest in judge.FARTHEST.items():
        begun, old, new = (
            judge.refinement_errors(validation, predictor, s, farthest, options.seed)
            for s in (replace(settings, iterations=0), settings, changed)
        )
        verdicts[name] = judge.judged_regression(begun, old, new, judge.overlaps(validation))
    return {
        "start": rounded(start),
        "learned": rounded(values),
        "at_the_bound": at_the_bound(start, values),
        "loss": losses(loss, problems, held_out, start, values),
        "validation": verdicts,
    }


def descent(options: argparse.Namespace) -> Descent:
    return Descent(options.steps, options.batch, options.rate, options.seed)


def losses(
    loss: Loss[Problem],
    train: Sequence[Problem],
    validation: Sequence[Problem],
    start: Values,
    values: Values,
) -> Json:
    """Mean losses of both splits under both values."""
    return {
        split: {"problems": len(problems)}
        | {
            name: round(mean_loss(loss, problems, v), 6)
            for name, v in (("start", start), ("learned", values))
        }
        for split, problems in (("train", train), ("validation", validation))
    }


def rounded(values: Values) -> Json:
    return {name: np.round(value.double().numpy(), 4).tolist() for name, value in values.items()}


if __name__ == "__main__":
    main()
