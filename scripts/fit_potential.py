"""Fit the potential of two scans that stand in one room, and store it in the package.

    python scripts/fit_potential.py --rooms 80 --cache results/potential

Pseudo-likelihood: in generated rooms of the validation split that played no part in fitting the
candidates' probabilities, one scan of a set is put beside one to four others that stand right. Of
all places that candidates and the aligner propose for it, one is right or none is; the log odds of
a place are the sum of the potentials of the pairs that it creates. The report is of rooms in turn
held out by quarters; what is stored is fitted to all.
"""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor, nn

from fewview import synthetic, weights
from fewview.completion import complete
from fewview.config import Config
from fewview.evaluation.overlap import overlap_matrix
from fewview.executor import Executor
from fewview.geometry import se3
from fewview.geometry.camera import backproject
from fewview.global_stage.model import build
from fewview.global_stage.placement import State
from fewview.global_stage.places import created, proposed
from fewview.matching.prepared import PreparedScan, aligned, prepare
from fewview.pairwise import match_pair
from fewview.probability import CLIP, ProbabilityModel
from fewview.together import VOTES, PotentialModel, Together, pair_quantities
from fewview.types import Array, BoolArray, PairResult

FIRST_ROOM = 64
"""Of the validation split; those before it made the candidates' probabilities."""
VIEWS, SIZE, EXTREME_SETS, MAX_OVERLAP = 16, 5, 2, 0.1
RIGHT_DEG, RIGHT_M = 15.0, 0.3
QUANTITIES = (
    VOTES,
    "aligner",
    "aligner_yaw",
    "visible",
    "on_surface",
    "violation",
    "upright_seen",
    "upright",
    "overlap",
    "residual",
    "colour",
    "met",
    "inside",
    "through",
    "foreseen",
    "tilt",
    "floor_gap",
    "yaw",
    "facing",
    "distance",
)
HIDDEN, RIDGE, HIDDEN_RIDGE, WEIGHT = 12, 2.0, 5.0, 0.3
"""Inner units; ridges on outer and inner coefficients; what a sample counts, as the samples of a
set share their scans."""
START, ITERATIONS, FOLDS = 0.1, 400, 4

Json = dict[str, Any]


@dataclass(frozen=True)
class Sample:
    """A scan beside m others that stand right.

    Attributes:
        room: where; kind: of set.
        quantities: (m, K, d) of the pairs that each of K places creates.
        turns_deg, shifts_m: (K,) how far each place is from the true one.
    """

    room: int
    kind: str
    quantities: Array
    turns_deg: Array
    shifts_m: Array

    @property
    def right(self) -> BoolArray:
        """(K,) places within the protocol's bounds."""
        return np.asarray((self.turns_deg < RIGHT_DEG) & (self.shifts_m < RIGHT_M))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rooms", type=int, default=80)
    parser.add_argument("--cache", type=Path, default=Path("results/potential"))
    parser.add_argument("--out", type=Path, default=weights.FOLDER / "potential.json")
    options = parser.parse_args()
    options.cache.mkdir(parents=True, exist_ok=True)
    rooms = range(FIRST_ROOM, FIRST_ROOM + options.rooms)
    samples = [sample for room in rooms for sample in cached(options.cache, room)]
    report = held_out(samples)
    print(json.dumps(report, indent=1))
    text = json.dumps(stored(fitted(samples), options.rooms, report), indent=1)
    options.out.write_text(text + "\n")


def cached(cache: Path, room: int) -> list[Sample]:
    """The samples of a room, kept in an .npz."""
    path = cache / f"room-{room:03d}.npz"
    if not path.is_file():
        samples = list(samples_of(room, *matched_room(room)))
        arrays = {
            f"{k}/{sample.kind}/{name}": getattr(sample, name)
            for k, sample in enumerate(samples)
            for name in ("quantities", "turns_deg", "shifts_m")
        }
        np.savez(path, **arrays)
        print(f"room {room}: {len(samples)} samples", flush=True)
    with np.load(path) as kept:
        heads = dict.fromkeys(name.rpartition("/")[0] for name in kept.files)
        return [
            Sample(
                room,
                head.split("/")[1],
                *(kept[f"{head}/{name}"] for name in ("quantities", "turns_deg", "shifts_m")),
            )
            for head in heads
        ]


Matched = tuple[
    list[tuple[str, list[int]]], Array, dict[int, PreparedScan], dict[tuple[int, int], PairResult]
]


def matched_room(room: int) -> Matched:
    """Sets of views of a room by kind, the true poses, the scans and the pairs of the sets."""
    config = Config()
    scene = synthetic.generate(synthetic.split_seed("validation", room), VIEWS, room, "random")
    frames, poses = list(scene.frames), np.stack([scene.poses[name] for name in scene.names])
    clouds = [
        backproject(frame.depth, frame.intrinsics)[frame.depth > 0].astype(np.float64)
        for frame in frames
    ]
    overlap = overlap_matrix(clouds, poses)
    rng = np.random.default_rng(room)
    sets = [("extreme", found) for found in apart(overlap, rng)]
    sets.append(("random", sorted(rng.choice(VIEWS, SIZE, replace=False).tolist())))
    needed = sorted({i for _, members in sets for i in members})
    executor = Executor()

    def one(i: int) -> PreparedScan:
        return prepare(complete(str(i), frames[i], 0, config.features, i))

    scans = dict(zip(needed, executor.map(one, needed), strict=True))
    pairs = sorted({pair for _, members in sets for pair in itertools.combinations(members, 2)})
    results = executor.map(lambda p: match_pair(scans[p[0]], scans[p[1]], p, config), pairs)
    return sets, poses, scans, dict(zip(pairs, results, strict=True))


def apart(overlap: Array, rng: np.random.Generator) -> list[list[int]]:
    """Sets of views no two of which share more than `MAX_OVERLAP`."""
    found: list[list[int]] = []
    for _ in range(300):
        chosen: list[int] = []
        for i in rng.permutation(VIEWS).tolist():
            if len(chosen) < SIZE and all(overlap[i, j] <= MAX_OVERLAP for j in chosen):
                chosen.append(i)
        if len(chosen) == SIZE and all(len({*chosen} & {*other}) < SIZE - 1 for other in found):
            found.append(sorted(chosen))
        if len(found) == EXTREME_SETS:
            break
    return found


def samples_of(
    room: int,
    sets: Sequence[tuple[str, list[int]]],
    poses: Array,
    scans: dict[int, PreparedScan],
    pairs: dict[tuple[int, int], PairResult],
) -> Iterator[Sample]:
    """Every scan of every set beside one, two, ... of the others."""
    rng = np.random.default_rng(room)
    for kind, members in sets:
        for scan in members:
            others = [i for i in members if i != scan]
            for size in range(1, SIZE):
                beside = rng.permutation(others)[:size].tolist()
                yield sample_of(room, kind, sorted([scan, *beside]), scan, poses, scans, pairs)


def sample_of(
    room: int,
    kind: str,
    members: list[int],
    scan: int,
    poses: Array,
    scans: dict[int, PreparedScan],
    pairs: dict[tuple[int, int], PairResult],
) -> Sample:
    """One of the members taken out of its place."""
    place = {i: k for k, i in enumerate(members)}
    results = [
        replace(pairs[i, j], source=place[i], target=place[j])
        for i, j in itertools.combinations(members, 2)
    ]
    problem = build(len(members), results, Config().global_stage)
    block = np.arange(len(members)) == place[scan]
    state = State(poses[members], block.astype(np.int64))
    together = Together(lambda k: scans[members[k]], NOTHING)
    motions, frames = proposed(problem, state, block, together)
    motions, frames = motions[1:], frames[1:]
    asked = []
    for pair in created(problem, state, block, motions, frames):
        source, target = scans[members[pair.source]], scans[members[pair.target]]
        alignment = aligned(source, target)
        assert alignment is not None
        found = pair_quantities(source, target, pair.poses, alignment) | {VOTES: pair.votes}
        asked.append(np.stack([found[name] for name in QUANTITIES], axis=1))
    turn, shift = se3.distance(motions @ poses[scan], poses[scan])
    return Sample(room, kind, np.stack(asked), np.degrees(turn), shift)


def fitted(samples: Sequence[Sample]) -> PotentialModel:
    """Maximum pseudo-likelihood with ridges."""
    rows = np.concatenate([s.quantities.reshape(-1, len(QUANTITIES)) for s in samples])
    mean, scale = rows.mean(axis=0), rows.std(axis=0) + 1e-6
    f, pairs, places, right = _padded(samples, mean, scale)
    d = len(QUANTITIES)
    shapes = [(d,), (), (HIDDEN, d), (HIDDEN,), (HIDDEN,), ()]
    sizes = [int(np.prod(shape)) for shape in shapes]

    def parts(parameters: Tensor) -> list[Tensor]:
        return [p.reshape(s) for p, s in zip(torch.split(parameters, sizes), shapes, strict=True)]

    def loss(values: Array) -> tuple[float, Array]:
        parameters = torch.from_numpy(values).requires_grad_()
        w, b, u, c, v, join = parts(parameters)
        potential = f @ w + b + torch.tanh(f @ u.T + c) @ v
        z = (potential * pairs[:, :, None]).sum(dim=1) + join
        z = nn.functional.pad(z.masked_fill(~places, -torch.inf), (1, 0))
        error = WEIGHT * nn.functional.cross_entropy(z, right, reduction="sum")
        error = error + RIDGE * w.square().sum() + HIDDEN_RIDGE * (u.square().sum() + v @ v)
        (slope,) = torch.autograd.grad(error, parameters)
        return error.item(), slope.numpy()

    start = np.random.default_rng(0).normal(0.0, START, sum(sizes))
    start[: d + 1] = start[-1] = 0.0
    found = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": ITERATIONS})
    w, b, u, c, v, join = (p.numpy() for p in parts(torch.from_numpy(found.x)))
    model = ProbabilityModel(QUANTITIES, mean, scale, w, float(b), u, c, v)
    return PotentialModel(model, float(join))


def _padded(
    samples: Sequence[Sample], mean: Array, scale: Array
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Standardised quantities (S, m, K, d), which pairs (S, m) and places (S, K) there are, and
    the right place from 1 on, 0 for none."""
    most = max(s.quantities.shape[1] for s in samples)
    f = torch.zeros(len(samples), SIZE - 1, most, len(QUANTITIES), dtype=torch.float64)
    pairs = torch.zeros(f.shape[:2], dtype=torch.float64)
    places = torch.zeros(len(samples), most, dtype=torch.bool)
    right = torch.zeros(len(samples), dtype=torch.int64)
    for k, sample in enumerate(samples):
        m, count, _ = sample.quantities.shape
        standard = np.clip((sample.quantities - mean) / scale, -CLIP, CLIP)
        f[k, :m, :count] = torch.from_numpy(standard)
        pairs[k, :m], places[k, :count] = 1.0, True
        if sample.right.any():
            error = sample.turns_deg / RIGHT_DEG + sample.shifts_m / RIGHT_M
            right[k] = 1 + int(np.where(sample.right, error, np.inf).argmin())
    return f, pairs, places, right


def probabilities(model: PotentialModel, sample: Sample) -> Array:
    """(1 + K,) of none and of each place."""
    m, count, d = sample.quantities.shape
    f = model.pair.standard(sample.quantities.reshape(-1, d))
    z = model.pair.logits_of(f).reshape(m, count).sum(axis=0) + model.join
    z = np.append(0.0, z)
    return np.asarray(np.exp(z - np.logaddexp.reduce(z)))


def held_out(samples: Sequence[Sample]) -> Json:
    """What models fitted without a quarter of the rooms say of it, by kind of set and number of
    scans beside."""
    rooms = sorted({sample.room for sample in samples})
    told: dict[str, list[tuple[Any, ...]]] = {}
    for fold in range(FOLDS):
        out = {room for k, room in enumerate(rooms) if k % FOLDS == fold}
        model = fitted([s for s in samples if s.room not in out])
        for sample in (s for s in samples if s.room in out):
            p = probabilities(model, sample)
            best = int(p[1:].argmax())
            chance = p[1:][sample.right].sum() if sample.right.any() else p[0]
            row = sample.right.any(), sample.right[best], p[1 + best], chance
            told.setdefault(f"{sample.kind}, beside {len(sample.quantities)}", []).append(row)
    return {name: _summary(np.array(rows)) for name, rows in sorted(told.items())}


def _summary(rows: Array) -> Json:
    proposed_right, best_right, probability, chance = rows.T
    sure = probability > 0.5
    return {
        "samples": len(rows),
        "right_proposed": round(float(proposed_right.mean()), 3),
        "best_right": round(float(best_right.mean()), 3),
        "above_half": round(float(sure.mean()), 3),
        "above_half_and_right": round(float((sure * best_right).mean()), 3),
        "mean_probability": round(float(probability.mean()), 3),
        "log_loss": round(float(-np.log(np.maximum(chance, 1e-9)).mean()), 3),
    }


def stored(model: PotentialModel, rooms: int, report: Json) -> Json:
    pair = model.pair
    arrays = ("mean", "scale", "coefficients", "inner", "inner_offsets", "outer")
    return {
        "features": list(pair.features),
        **{name: getattr(pair, name).round(6).tolist() for name in arrays},
        "intercept": round(pair.intercept, 6),
        "join": round(model.join, 6),
        "made": {
            "by": "scripts/fit_potential.py",
            "model": f"sum over pairs, {HIDDEN} inner units, ridges {RIDGE} and {HIDDEN_RIDGE}",
            "right_within": {"deg": RIGHT_DEG, "m": RIGHT_M},
            "rooms": [FIRST_ROOM, FIRST_ROOM + rooms],
            "config_hash": Config().hash(),
            "held_out": report,
        },
    }


NOTHING = PotentialModel(
    ProbabilityModel(
        features=(VOTES,),
        mean=np.zeros(1),
        scale=np.ones(1),
        coefficients=np.zeros(1),
        intercept=0.0,
        inner=np.zeros((0, 1)),
        inner_offsets=np.zeros(0),
        outer=np.zeros(0),
    ),
    join=0.0,
)
"""Stands in where places are only proposed, not judged."""


if __name__ == "__main__":
    main()
