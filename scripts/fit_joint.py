"""Phase three of the paper's training: networks and hyper-parameters together (Sec. 3.4).

    python scripts/fit_joint.py [--steps 300] [--grid-steps 40] [--set KEY=VALUE ...] [--out DIR]

Fine-tunes the shipped 360-image and relation networks with l_1 + lambda_2 l_2 + lambda_3 l_3 +
lambda_4 l_4. The lambdas are those of a small grid with which a short run lowers the four losses of
validation rooms most, each as a share of what it was; the best one is trained on. Writes what that
changed on validation pairs with a verdict, and the networks' weights. Nothing is shipped by itself.
"""

from __future__ import annotations

import argparse
import itertools
import json
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from fewview import weights
from fewview.training import loop, settings
from fewview.training.joint import JointProblem
from fewview.training.rooms import RoomBatches, loader, source_of
from fewview.training.settings import TrainConfig

Json = dict[str, Any]
ROOT = Path(__file__).resolve().parents[1]
LOSSES = ("completion_loss", "relation_loss", "spectral_loss", "regression_loss")
LOWEST = {"spectral_loss": -1.0}
"""Of the losses that are not 0 at best."""
GRID = {"lambda_2": (0.3, 1.0), "lambda_3": (0.1, 1.0), "lambda_4": (0.3, 3.0)}
VALIDATION_BATCH = 4
KEPT = ("seen_mean", "predicted_mean", "log_depth")
"""Figures that must not get worse; the last is better the lower."""
NETWORKS = ("panorama", "relation")


def main() -> None:
    """Parse the arguments, choose the lambdas, train, judge, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--grid-steps", type=int, default=40, help="of each run of the grid")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--out", type=Path, default=Path("results/joint"))
    options = parser.parse_args()
    config = settings.load(ROOT / "configs" / "train_joint.yaml", tuple(options.set))
    before = measured(config, {})
    runs: list[Json] = []
    for values in itertools.product(*GRID.values()):
        lambdas = dict(zip(GRID, values, strict=True))
        after = trained(config, lambdas, options.grid_steps, options.out / _named(lambdas))
        runs.append({**lambdas, "score": score(before, after), "validation": after})
        print(json.dumps(runs[-1]), flush=True)
    best = {name: min(runs, key=lambda run: float(run["score"]))[name] for name in GRID}
    after = trained(config, best, options.steps, options.out / "chosen")
    split(options.out / "chosen", options.out)
    report = {
        "lambdas": best,
        "grid": runs,
        "before": before,
        "after": after,
        "score": score(before, after),
        "ship": ship(before, after),
        "learned": learned(options.out / "chosen"),
    }
    print(json.dumps(report, indent=1))
    (options.out / "joint.json").write_text(json.dumps(report, indent=1) + "\n")


def trained(config: TrainConfig, lambdas: Json, steps: int, out: Path) -> dict[str, float]:
    """Train, or read what was trained, with some lambdas; the validation of the best weights."""
    problem = config.settings
    assert isinstance(problem, JointProblem)
    run = replace(
        config,
        settings=replace(problem, **lambdas),
        steps=steps,
        validate_every=min(config.validate_every, steps),
        warmup_steps=min(config.warmup_steps, steps // 4),
    )
    done = (out / f"{problem.name}.json").is_file()
    if not done:
        resume = (out / loop.CHECKPOINT).is_file()
        loop.train(run, out, resume=resume, jobs=1, report=lambda line: print(line, flush=True))
    state, _ = weights.load(problem.name, out)
    return measured(config, state)


def measured(config: TrainConfig, state: dict[str, Tensor]) -> dict[str, float]:
    """Figures of the validation rooms: of the shipped weights without a state."""
    problem = config.settings
    network = problem.network()
    if state:
        network.load_state_dict(state)
    network.eval()
    batches = RoomBatches(config, source_of(config), "validation", VALIDATION_BATCH)
    found: dict[str, list[float]] = defaultdict(list)
    with torch.inference_mode():
        for batch in loader(batches, range(config.validation_rooms // VALIDATION_BATCH), 1):
            for name, value in problem.metrics(network, batch).items():
                found[name].append(value)
    return {name: float(np.nanmean(values)) for name, values in found.items()}


def score(before: dict[str, float], after: dict[str, float]) -> float:
    """Mean over the losses of what is left of each, 1 when nothing has changed."""
    left = [
        (after[name] - LOWEST.get(name, 0.0)) / (before[name] - LOWEST.get(name, 0.0))
        for name in LOSSES
    ]
    return float(np.mean(left))


def ship(before: dict[str, float], after: dict[str, float]) -> bool:
    """Whether all losses fell, and none of the accuracies."""
    lower = all(after[name] < before[name] for name in (*LOSSES, KEPT[-1]))
    return lower and all(after[name] >= before[name] for name in KEPT[:-1])


def split(run: Path, out: Path) -> None:
    """The networks of a joint run as weights of their own, with the run's card beside theirs."""
    state, card = weights.load("joint", run)
    for name in NETWORKS:
        own = {k.removeprefix(f"{name}."): v for k, v in state.items() if k.startswith(f"{name}.")}
        _, before = weights.load(name)
        kept = {key: card[key] for key in ("seed", "steps", "hours", "hardware", "validation")}
        weights.save(name, out, own, {**before, "joint": kept})


def learned(run: Path) -> Json:
    """Hyper-parameters of a joint run."""
    state, _ = weights.load("joint", run)
    names = ("log_gammas", "log_alphas")
    return {name.removeprefix("log_"): state[name].exp().tolist() for name in names}


def _named(lambdas: Json) -> str:
    return "grid-" + "-".join(f"{value:g}" for value in lambdas.values())


if __name__ == "__main__":
    main()
