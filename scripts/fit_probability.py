"""Fit the candidate probabilities on validation scenes and store them in the package.

    python scripts/fit_probability.py --scene FOLDER ... --check FOLDER ... [--observed]

Validation scenes are generated rooms of the validation split, corridors whose second half is the
mirror image of the first, and folders given with --scene; folders given with --check are never
fitted to, they only show how the result carries over. Each room and each corridor is seen twice,
the second time through a sensor whose calibration is off. Beside the views of a room there are
guests for which no candidate is right: strangers from another room, and twins from the mirror image
of this one. With --observed no network completes the scans, and the model for
scans as seen is fitted. With --without NAME ... evidence is left out, to see what it is worth;
write that one elsewhere with --out.
"""

from __future__ import annotations

import argparse
import itertools
import json
import platform
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor, nn

from fewview import weights
from fewview.completion import OBSERVED_KINDS, complete
from fewview.config import Config
from fewview.evaluation.calibration import expected_calibration_error
from fewview.executor import Executor
from fewview.geometry import se3
from fewview.matching.prepared import PreparedScan, prepare
from fewview.pairwise import weigh_pair
from fewview.probability import ARRAYS, ProbabilityModel
from fewview.types import Array, Frame
from validation_views import WARPED, corridor_views, folder_views, strangers, twins, views

RIGHT_DEG, RIGHT_M = 15.0, 0.3
SEEN = (
    "xfeat",
    "sift",
    "planes",
    "share",
    "lead",
    "spread",
    "overlap",
    "residual",
    "colour",
    "concordance",
    "visible",
    "on_surface",
    "violation",
    "tilt",
    "floor_gap",
    "yaw",
    "facing",
    "manhattan",
    "raster",
    "upright",
    "upright_seen",
    "looseness",
    "alone_overlap",
    "alone_upright",
    "alone_violation",
    "alone_looseness",
    "alone_colour",
    "alone_concordance",
    "alone_facing",
)
COMPLETED = (
    "panorama",
    "layout",
    "structure",
    "completion",
    "alignment",
    "aligner",
    "aligner_yaw",
    "met",
    "inside",
    "through",
    "foreseen",
    "alone_aligner",
    "alone_aligner_yaw",
    "alone_met",
    "alone_inside",
    "alone_through",
)
GUESTS, BESIDE = 2, 3
"""Guests of either kind, and how many views of the room each is matched with at most; a twin with
the view that it mirrors too."""
NOWHERE_M = 1000.0
"""Guests stand this far from the room, so that every pose between them is wrong."""
GUEST_WEIGHT = 0.1
"""What a pair with a guest counts: of 0.3 and 1, scans of real sensors are doubted as well."""
RIDGE, HIDDEN_RIDGE = 2.0, 10.0
HIDDEN = 8
START = 0.1
ITERATIONS = 400
PAIRS_OF_A_SCENE = 45.0
"""A scene of so many pairs counts one for each; one of n times as many counts sqrt(n) as much."""


@dataclass(frozen=True)
class Pair:
    """Candidates of a pair as named features, and how far each is from the truth."""

    scene: str
    candidates: list[dict[str, float]]
    turns_deg: list[float]
    shifts_m: list[float]

    @property
    def with_guest(self) -> bool:
        """Whether one scan stands nowhere near the other."""
        return min(self.shifts_m, default=0.0) > 0.5 * NOWHERE_M

    @cached_property
    def right(self) -> int | None:
        """The candidate that is right and nearest to the truth; None: none is right."""
        turns, shifts = np.array(self.turns_deg), np.array(self.shifts_m)
        right = (turns < RIGHT_DEG) & (shifts < RIGHT_M)
        error = turns / RIGHT_DEG + shifts / RIGHT_M
        return int(np.where(right, error, np.inf).argmin()) if right.any() else None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rooms", type=int, default=64)
    parser.add_argument("--corridors", type=int, default=24)
    parser.add_argument("--views", type=int, default=8)
    parser.add_argument("--scene", type=Path, nargs="*", default=[])
    parser.add_argument("--check", type=Path, nargs="*", default=[])
    parser.add_argument("--cache", type=Path, default=Path("results/probability"))
    parser.add_argument("--observed", action="store_true", help="for scans as seen")
    parser.add_argument("--without", nargs="*", default=[], help="evidence to leave out")
    parser.add_argument("--out", type=Path, default=weights.FOLDER)
    options = parser.parse_args()
    kind = "observed" if options.observed else "completed"
    config = observed(Config()) if options.observed else Config()
    cache = options.cache / kind
    cache.mkdir(parents=True, exist_ok=True)
    rooms = range(options.rooms)
    fit = []
    for i, warped in itertools.product(rooms, (False, True)):
        make = partial(room, i, rooms, options.views, config, warped)
        fit += cached(cache, f"room-{i}{WARPED * warped}", make)
    for i, warped in itertools.product(range(options.corridors), (False, True)):
        make = partial(corridor, i, config, warped)
        fit += cached(cache, f"corridor-{i}{WARPED * warped}", make)
    fit += [p for f in options.scene for p in cached(cache, f.name, lambda f=f: folder(f, config))]
    check = {f.name: cached(cache, f.name, lambda f=f: folder(f, config)) for f in options.check}
    names = SEEN if options.observed else SEEN + COMPLETED
    left_out = {*options.without, *(f"alone_{name}" for name in options.without)}
    model = fitted(fit, tuple(name for name in names if name not in left_out))
    report = {"fit": summary(model, fit)} | {k: summary(model, v) for k, v in check.items()}
    print(json.dumps(report, indent=1))
    if check:
        held_out = [p for pairs in check.values() for p in pairs]
        report["all_checked"] = summary(model, held_out)
        print("all checked:", report["all_checked"])
    text = json.dumps(stored(model, config, options, report), indent=1)
    (options.out / f"probability_{kind}.json").write_text(text + "\n")


def observed(config: Config) -> Config:
    """The settings without what the networks complete."""
    kinds = tuple(kind.name for kind in OBSERVED_KINDS)
    return replace(config, features=replace(config.features, kinds=kinds))


def cached(cache: Path, name: str, make: Any) -> list[Pair]:
    path = cache / f"{name}.json"
    if not path.is_file():
        pairs = list(make())
        path.write_text(json.dumps([asdict(p) for p in pairs]))
        right = sum(p.right is not None for p in pairs)
        print(f"{name}: {len(pairs)} pairs, {right} with a right candidate", flush=True)
    return [Pair(**p) for p in json.loads(path.read_text())]


def room(index: int, rooms: range, count: int, config: Config, warped: bool) -> Iterator[Pair]:
    """Views of a generated room in pairs, and guests beside some of them; strangers come from the
    next of the rooms."""
    frames, poses = views(index, count, "spread" if index % 2 else "random", warped)
    others = strangers([*rooms[index + 1 :], *rooms[:index]], GUESTS, warped)
    guests = [*others[0], *twins(frames[:GUESTS], poses[:GUESTS])[0]]
    every = [*frames, *guests]
    rng = np.random.default_rng(index)
    pairs = list(itertools.combinations(range(count), 2))
    for guest in range(count, len(every)):
        beside = {(guest - count) % GUESTS, *rng.choice(count, BESIDE - 1, replace=False).tolist()}
        pairs += [(view, guest) for view in sorted(beside)]
    nowhere = se3.pose(np.eye(3), np.array([NOWHERE_M, 0.0, 0.0]))
    where = np.concatenate([poses, np.tile(nowhere, (len(guests), 1, 1))])
    yield from weighed(f"room-{index}", every, where, pairs, config)


def corridor(index: int, config: Config, warped: bool) -> Iterator[Pair]:
    """Views of a corridor whose halves look alike, all pairs of them."""
    frames, poses = corridor_views(index, warped)
    pairs = list(itertools.combinations(range(len(frames)), 2))
    yield from weighed(f"corridor-{index}", frames, poses, pairs, config)


def folder(path: Path, config: Config) -> Iterator[Pair]:
    """Scans with ground truth, all pairs of them."""
    frames, poses = folder_views(path)
    pairs = list(itertools.combinations(range(len(frames)), 2))
    yield from weighed(path.name, frames, poses, pairs, config)


def weighed(
    name: str, frames: list[Frame], poses: Array, pairs: list[tuple[int, int]], config: Config
) -> Iterator[Pair]:
    """Candidates of pairs of n frames with (n, 4, 4) true poses."""
    executor = Executor()

    def scan(i: int) -> PreparedScan:
        return prepare(complete(str(i), frames[i], 0, config.features, i))

    scans = list(executor.map(scan, range(len(frames))))

    def one(pair: tuple[int, int]) -> Pair:
        i, j = pair
        found = weigh_pair(scans[i], scans[j], config)
        truth = se3.inverse(poses[j]) @ poses[i]
        turn, shift = se3.distance(found.poses, truth)
        evidence = [dict(e.features) for e in found.evidence]
        return Pair(name, evidence, np.degrees(turn).tolist(), shift.tolist())

    yield from executor.map(one, pairs)


def fitted(pairs: list[Pair], names: tuple[str, ...]) -> ProbabilityModel:
    """Maximum likelihood of the conditional logit with ridges."""
    pairs = [p for p in pairs if p.candidates]
    stacked = np.array([[c[f] for f in names] for p in pairs for c in p.candidates])
    mean, scale = stacked.mean(axis=0), stacked.std(axis=0) + 1e-6
    shapes = [(len(names),), (), (HIDDEN, len(names)), (HIDDEN,), (HIDDEN,)]
    sizes = [int(np.prod(shape)) for shape in shapes]

    def parts(parameters: Tensor) -> list[Tensor]:
        return [p.reshape(s) for p, s in zip(torch.split(parameters, sizes), shapes, strict=True)]

    def model(parameters: Array) -> ProbabilityModel:
        w, b, u, c, v = (p.numpy() for p in parts(torch.from_numpy(parameters)))
        return ProbabilityModel(names, mean, scale, w, float(b), u, c, v)

    start = np.random.default_rng(0).normal(0.0, START, sum(sizes))
    start[: len(names) + 1] = 0.0
    f, there, right, weight = _padded(pairs, model(start))

    def loss(values: Array) -> tuple[float, Array]:
        parameters = torch.from_numpy(values).requires_grad_()
        w, b, u, c, v = parts(parameters)
        z = f @ w + b + torch.tanh(f @ u.T + c) @ v
        z = nn.functional.pad(z.masked_fill(~there, -torch.inf), (1, 0))
        error = (weight * nn.functional.cross_entropy(z, right, reduction="none")).sum()
        error = error + RIDGE * w.square().sum() + HIDDEN_RIDGE * (u.square().sum() + v @ v)
        (slope,) = torch.autograd.grad(error, parameters)
        return error.item(), slope.numpy()

    found = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": ITERATIONS})
    return model(found.x)


def _padded(pairs: list[Pair], model: ProbabilityModel) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Standardised evidence (P, K, d), which candidates there are (P, K), the right one (P,) from
    1 on or 0 for none, and the pairs' weights (P,)."""
    count = torch.tensor([len(p.candidates) for p in pairs])
    there = torch.arange(int(count.max())) < count[:, None]
    rows = model.standardised([c for p in pairs for c in p.candidates])
    f = torch.zeros(*there.shape, rows.shape[1], dtype=torch.float64)
    f[there] = torch.from_numpy(rows)
    right = torch.tensor([0 if p.right is None else p.right + 1 for p in pairs])
    sizes = Counter(p.scene for p in pairs)
    weight = torch.tensor(
        [
            (PAIRS_OF_A_SCENE / sizes[p.scene]) ** 0.5 * (GUEST_WEIGHT if p.with_guest else 1.0)
            for p in pairs
        ]
    )
    return f, there, right, weight


def summary(model: ProbabilityModel, pairs: list[Pair]) -> dict[str, float]:
    """How the model does on pairs: calibration of all candidates, and the best one's hits."""
    probability, outcome, hits, sure, wrong, surprise = [], [], 0, 0, 0, 0.0
    for pair in pairs:
        if not pair.candidates:
            continue
        p = model.probabilities(pair.candidates)
        probability += p.tolist()
        outcome += [k == pair.right for k in range(len(p))]
        chance = 1.0 - p.sum() if pair.right is None else p[pair.right]
        surprise -= float(np.log(max(chance, 1e-9)))
        best = int(p.argmax())
        hits += best == pair.right
        sure += p[best] > 0.5
        wrong += p[best] > 0.5 and best != pair.right
    return {
        "pairs": len(pairs),
        "with_right_candidate": sum(p.right is not None for p in pairs),
        "best_is_right": int(hits),
        "above_half": int(sure),
        "above_half_and_wrong": int(wrong),
        "log_loss": round(surprise / len(pairs), 4),
        "ece": round(expected_calibration_error(np.array(probability), np.array(outcome)), 4),
    }


def stored(
    model: ProbabilityModel, config: Config, options: argparse.Namespace, report: dict[str, Any]
) -> dict[str, Any]:
    return {
        "features": list(model.features),
        **{name: getattr(model, name).round(6).tolist() for name in ARRAYS},
        "intercept": round(model.intercept, 6),
        "made": {
            "by": "scripts/fit_probability.py",
            "model": f"conditional logit, ridge {RIDGE}, {HIDDEN} hidden, ridge {HIDDEN_RIDGE}",
            "right_within": {"deg": RIGHT_DEG, "m": RIGHT_M},
            "rooms": options.rooms,
            "corridors": options.corridors,
            "views_per_room": options.views,
            "scenes": [f.name for f in options.scene],
            "checked_on": [f.name for f in options.check],
            "config_hash": config.hash(),
            "python": platform.python_version(),
            "report": report,
        },
    }


if __name__ == "__main__":
    main()
