"""Fit the potential of two scans that stand in one room, and store it in the package.

    python scripts/fit_potential.py --rooms 80 --scene FOLDER ... --check FOLDER ...

Pseudo-likelihood: in generated rooms of the validation split that played no part in fitting the
candidates' probabilities, and in folders given with --scene, one or two scans of a set are put
beside others that stand right. Of all places that candidates and the aligner propose for them, one
is right or none is; the log odds of a place are the sum of the potentials of the pairs that it
creates. Guests are put beside each set too, for which no place is right: strangers, scans of the
next room, and twins, scans of the room that is the mirror image of this one.
The report is of scenes in turn held out by quarters, and of folders given with --check, which are
never fitted to; what is stored is fitted to all others.
"""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor, nn

from fewview import scans as readers
from fewview import synthetic, weights
from fewview.completion import complete
from fewview.config import Config
from fewview.errors import FewviewError
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
from fewview.types import Array, BoolArray, Frame, PairResult

FIRST_ROOM = 64
"""Of the validation split; those before it made the candidates' probabilities."""
VIEWS, SIZE, MAX_OVERLAP = 16, 5, 0.1
EXTREME_SETS, RANDOM_SETS = 2, 1
GUESTS, BLOCKS = 2, 2
BESIDE = {
    "strangers": ((1, 1), (1, 2), (1, 3), (1, 4), (2, 2), (2, 3)),
    "twins": ((1, 4), (2, 3)),
}
"""How many guests stand beside how many scans of a set."""
SETS_OF_A_FOLDER, MOST_FRAMES = (6, 4), 24
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
    """A block of scans beside others that stand right.

    Attributes:
        scene: where; kind: of set, and how many scans stand beside how many.
        quantities: (m, K, d) of the m pairs that each of K places creates.
        turns_deg, shifts_m: (K,) how far each place is from the true one.
    """

    scene: str
    kind: str
    quantities: Array
    turns_deg: Array
    shifts_m: Array

    @property
    def right(self) -> BoolArray:
        """(K,) places within the protocol's bounds."""
        return np.asarray((self.turns_deg < RIGHT_DEG) & (self.shifts_m < RIGHT_M))


@dataclass(frozen=True)
class Matched:
    """A scene with its pairs.

    Attributes:
        sets: kind and views of each.
        guests: kind and two views of each.
        poses: (n, 4, 4) true world_T_scan; those of guests are right among themselves.
        scans: of the sets, and the guests.
    """

    sets: list[tuple[str, list[int]]]
    guests: list[tuple[str, list[int]]]
    poses: Array
    scans: Mapping[int, PreparedScan]

    @cached_property
    def _pairs(self) -> dict[tuple[int, int], PairResult]:
        return {}

    def pair(self, i: int, j: int) -> PairResult:
        """The candidates of two scans, the first with the smaller index; matched when asked for."""
        if (i, j) not in self._pairs:
            self._pairs[i, j] = match_pair(self.scans[i], self.scans[j], (i, j), Config())
        return self._pairs[i, j]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rooms", type=int, default=80)
    parser.add_argument("--scene", type=Path, nargs="*", default=[])
    parser.add_argument("--check", type=Path, nargs="*", default=[])
    parser.add_argument("--cache", type=Path, default=Path("results/potential"))
    parser.add_argument("--out", type=Path, default=weights.FOLDER / "potential.json")
    options = parser.parse_args()
    options.cache.mkdir(parents=True, exist_ok=True)
    rooms = range(FIRST_ROOM, FIRST_ROOM + options.rooms)
    fit = [s for i in rooms for s in cached(options.cache, f"room-{i:03d}", partial(room, i))]
    fit += [s for f in options.scene for s in cached(options.cache, f.name, partial(folder, f))]
    check = [s for f in options.check for s in cached(options.cache, f.name, partial(folder, f))]
    model, report = fitted(fit), {"held out": held_out(fit)}
    for scene in dict.fromkeys(s.scene for s in check):
        report[scene] = told([(model, s) for s in check if s.scene == scene])
    print(json.dumps(report, indent=1))
    text = json.dumps(stored(model, options, report), indent=1)
    options.out.write_text(text + "\n")


def cached(cache: Path, name: str, make: Callable[[], Matched]) -> list[Sample]:
    """The samples of a scene, kept in an .npz."""
    path = cache / f"{name}.npz"
    if not path.is_file():
        samples = list(samples_of(name, make()))
        arrays = {
            f"{k}/{sample.kind}/{name}": getattr(sample, name)
            for k, sample in enumerate(samples)
            for name in ("quantities", "turns_deg", "shifts_m")
        }
        np.savez(path, **arrays)
        print(f"{name}: {len(samples)} samples", flush=True)
    with np.load(path) as kept:
        heads = dict.fromkeys(name.rpartition("/")[0] for name in kept.files)
        return [
            Sample(
                name,
                head.split("/")[1],
                *(kept[f"{head}/{part}"] for part in ("quantities", "turns_deg", "shifts_m")),
            )
            for head in heads
        ]


def room(index: int) -> Matched:
    """A generated room of the validation split, strangers from the next that has a place, twins."""
    frames, poses = _views(index, VIEWS)
    twins = _mirrored(frames[:GUESTS], poses[:GUESTS])
    guests = {"strangers": _strangers(index + 1), "twins": twins}
    return matched(frames, poses, EXTREME_SETS, RANDOM_SETS, index, guests)


def _strangers(index: int) -> tuple[list[Frame], Array]:
    try:
        return _views(index, GUESTS)
    except FewviewError:
        return _strangers(index + 1)


def _views(index: int, count: int) -> tuple[list[Frame], Array]:
    scene = synthetic.generate(synthetic.split_seed("validation", index), count, index, "random")
    return list(scene.frames), np.stack([scene.poses[name] for name in scene.names])


def _mirrored(frames: Sequence[Frame], poses: Array) -> tuple[list[Frame], Array]:
    """What the same cameras see in the mirror image of the room."""
    flip = np.diag([-1.0, 1.0, 1.0, 1.0])
    flipped = []
    for frame in frames:
        camera = frame.intrinsics
        turned = replace(camera, cx=camera.width - 1 - camera.cx)
        colour, depth = frame.colour[:, ::-1].copy(), frame.depth[:, ::-1].copy()
        flipped.append(replace(frame, colour=colour, depth=depth, intrinsics=turned))
    return flipped, flip @ poses @ flip


def folder(path: Path) -> Matched:
    """Scans with ground truth, at most `MOST_FRAMES` of them."""
    found, truth = readers.load(path).scans, readers.truth(path)
    known = [scan for scan in found if scan.name in truth]
    chosen = np.linspace(0, len(known) - 1, min(MOST_FRAMES, len(known))).astype(int)
    frames = [known[i].load() for i in chosen]
    poses = np.stack([truth[known[i].name] for i in chosen])
    return matched(frames, poses, *SETS_OF_A_FOLDER, seed=0)


def matched(
    frames: Sequence[Frame],
    poses: Array,
    extreme: int,
    random: int,
    seed: int,
    guests: Mapping[str, tuple[list[Frame], Array]] | None = None,
) -> Matched:
    """Draw sets of views and complete their scans and the guests."""
    config, rng = Config(), np.random.default_rng(seed)
    clouds = [
        backproject(frame.depth, frame.intrinsics)[frame.depth > 0].astype(np.float64)
        for frame in frames
    ]
    sets = [("extreme", found) for found in apart(overlap_matrix(clouds, poses), extreme, rng)]
    for _ in range(random):
        sets.append(("random", sorted(rng.choice(len(frames), SIZE, replace=False).tolist())))
    needed = sorted({i for _, members in sets for i in members})
    everything, known, invited = list(frames), [poses], []
    for kind, (views, where) in (guests or {}).items():
        invited.append((kind, list(range(len(everything), len(everything) + len(views)))))
        needed += invited[-1][1]
        everything += views
        known.append(where)

    def one(i: int) -> PreparedScan:
        return prepare(complete(str(i), everything[i], 0, config.features, i))

    scans = dict(zip(needed, Executor().map(one, needed), strict=True))
    return Matched(sets, invited, np.concatenate(known), scans)


def apart(overlap: Array, count: int, rng: np.random.Generator) -> list[list[int]]:
    """Sets of views no two of which share more than `MAX_OVERLAP`."""
    found: list[list[int]] = []
    for _ in range(300):
        chosen: list[int] = []
        for i in rng.permutation(len(overlap)).tolist():
            if len(chosen) < SIZE and all(overlap[i, j] <= MAX_OVERLAP for j in chosen):
                chosen.append(i)
        if len(chosen) == SIZE and all(len({*chosen} & {*other}) < SIZE - 1 for other in found):
            found.append(sorted(chosen))
        if len(found) == count:
            break
    return found


def samples_of(name: str, scene: Matched) -> Iterator[Sample]:
    """Every scan of every set beside one, two, ... of the others, two together beside others, and
    guests beside members."""
    rng = np.random.default_rng(0)
    for kind, members in scene.sets:
        for scan in members:
            others = rng.permutation([i for i in members if i != scan]).tolist()
            for size in range(1, SIZE):
                yield sample_of(name, kind, [scan], others[:size], scene)
    for kind, members in scene.sets:
        for _ in range(BLOCKS):
            order = rng.permutation(members).tolist()
            yield sample_of(name, kind, order[:2], order[2:], scene)
        for guest, views in scene.guests:
            order = rng.permutation(members).tolist()
            for count, beside in BESIDE[guest]:
                about = f"{kind}, {guest}"
                yield sample_of(name, about, views[:count], order[:beside], scene, guest=True)


def sample_of(
    name: str,
    kind: str,
    moved: Sequence[int],
    beside: Sequence[int],
    scene: Matched,
    guest: bool = False,
) -> Sample:
    """Some scans taken out of their place beside others, or guests beside them."""
    members = sorted([*moved, *beside])
    place = {i: k for k, i in enumerate(members)}
    results = [
        replace(scene.pair(i, j), source=place[i], target=place[j])
        for i, j in itertools.combinations(members, 2)
        if (i in moved) != (j in moved)
    ]
    problem = build(len(members), results, Config().global_stage)
    block = np.isin(members, moved)
    state = State(scene.poses[members], block.astype(np.int64))
    together = Together(lambda k: scene.scans[members[k]], NOTHING)
    motions, frames = proposed(problem, state, block, together)
    motions, frames = motions[1:], frames[1:]
    asked = []
    for pair in created(problem, state, block, motions, frames):
        source, target = (scene.scans[members[i]] for i in (pair.source, pair.target))
        alignment = aligned(source, target)
        assert alignment is not None
        found = pair_quantities(source, target, pair.poses, alignment) | {VOTES: pair.votes}
        asked.append(np.stack([found[name] for name in QUANTITIES], axis=1))
    true = scene.poses[moved[0]]
    turn, shift = se3.distance(motions @ true, true)
    return Sample(
        name,
        f"{kind}, {len(moved)} beside {len(beside)}",
        np.stack(asked),
        np.where(guest, 180.0, np.degrees(turn)),
        np.where(guest, np.inf, shift),
    )


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
    widest = max(len(s.quantities) for s in samples)
    f = torch.zeros(len(samples), widest, most, len(QUANTITIES), dtype=torch.float64)
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
    """What models fitted without a quarter of the scenes say of it."""
    scenes = sorted({sample.scene for sample in samples})
    judged = []
    for fold in range(FOLDS):
        out = set(scenes[fold::FOLDS])
        model = fitted([s for s in samples if s.scene not in out])
        judged += [(model, s) for s in samples if s.scene in out]
    return told(judged)


def told(judged: Sequence[tuple[PotentialModel, Sample]]) -> Json:
    """What models say of samples, by kind of set and number of scans beside."""
    rows: dict[str, list[tuple[Any, ...]]] = {}
    for model, sample in judged:
        p = probabilities(model, sample)
        best = int(p[1:].argmax())
        chance = p[1:][sample.right].sum() if sample.right.any() else p[0]
        row = sample.right.any(), sample.right[best], p[1 + best], chance
        rows.setdefault(sample.kind, []).append(row)
    return {name: _summary(np.array(found)) for name, found in sorted(rows.items())}


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


def stored(model: PotentialModel, options: argparse.Namespace, report: Json) -> Json:
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
            "rooms": [FIRST_ROOM, FIRST_ROOM + options.rooms],
            "scenes": [f.name for f in options.scene],
            "checked_on": [f.name for f in options.check],
            "config_hash": Config().hash(),
            "report": report,
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
