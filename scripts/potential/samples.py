"""Scans taken out of their place beside others: all places that anything proposes for them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fewview.config import Config
from fewview.geometry import se3
from fewview.global_stage.model import build
from fewview.global_stage.placement import State
from fewview.global_stage.places import created, overlaid, proposed
from fewview.matching.prepared import aligned
from fewview.probability import ProbabilityModel
from fewview.together import VOTES, PotentialModel, Together, pair_quantities
from fewview.types import Array, BoolArray
from potential.scenes import SIZE, Matched
from validation_views import WARPED

BLOCKS = 2
BESIDE = {
    "strangers": ((1, 1), (1, 2), (1, 3), (1, 4), (2, 2), (2, 3)),
    "twins": ((1, 4), (2, 3)),
}
"""How many guests stand beside how many scans of a set."""
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
    "concordance",
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
PARTS = ("quantities", "turns_deg", "shifts_m", "drawn")
"""Arrays of a sample."""

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
    drawn=1.0,
    typical=0.0,
)
"""Stands in where places are only proposed, not judged: its drawings say the log probability."""


@dataclass(frozen=True)
class Sample:
    """A block of scans beside others that stand right.

    Attributes:
        scene: where; warped: whether through a sensor whose calibration is off.
        kind: of set, and how many scans stand beside how many.
        quantities: (m, K, d) of the m pairs that each of K places creates.
        turns_deg, shifts_m: (K,) how far each place is from the true one.
        drawn: (K,) log probability that the aligner gives to each place of scans drawn as one; 0
            where there are only two.
    """

    scene: str
    warped: bool
    kind: str
    quantities: Array
    turns_deg: Array
    shifts_m: Array
    drawn: Array

    @property
    def several(self) -> bool:
        """Whether there are more scans than two: what two say of each other is a potential."""
        return len(self.quantities) > 1

    @property
    def right(self) -> BoolArray:
        """(K,) places within the protocol's bounds."""
        return np.asarray((self.turns_deg < RIGHT_DEG) & (self.shifts_m < RIGHT_M))


def cached(cache: Path, name: str, make: Callable[[], Matched]) -> list[Sample]:
    """The samples of a scene, kept in an .npz."""
    path = cache / f"{name}.npz"
    if not path.is_file():
        samples = list(samples_of(name, make()))
        arrays = {
            f"{k}/{sample.kind}/{part}": getattr(sample, part)
            for k, sample in enumerate(samples)
            for part in PARTS
        }
        np.savez(path, **arrays)
        print(f"{name}: {len(samples)} samples", flush=True)
    with np.load(path) as kept:
        heads = dict.fromkeys(name.rpartition("/")[0] for name in kept.files)
        return [
            Sample(*seen(name), head.split("/")[1], *(kept[f"{head}/{part}"] for part in PARTS))
            for head in heads
        ]


def seen(name: str) -> tuple[str, bool]:
    """The scene of a name, and whether it is seen through a sensor whose calibration is off."""
    return name.removesuffix(WARPED), name.endswith(WARPED)


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
    overlays = overlaid(state, block, together)
    [drawn] = overlays.values()
    motions, frames = proposed(problem, state, block, overlays)
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
        *seen(name),
        f"{kind}, {len(moved)} beside {len(beside)}",
        np.stack(asked),
        np.where(guest, 180.0, np.degrees(turn)),
        np.where(guest, np.inf, shift),
        drawn.log_odds(motions),
    )
