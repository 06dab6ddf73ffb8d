"""The relation network's batches: pairs of views under perturbed poses, pairs of their points."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import torch

from fewview.evaluation.relations import Relation, perturbed, true_relations
from fewview.geometry import se3
from fewview.refinement.relation_points import GREY
from fewview.training.problem import Batch
from fewview.training.relation_rooms import RelationRoom
from fewview.training.relation_views import PREDICTED, SEEN
from fewview.types import Array, BoolArray, FloatArray, IntArray

CANDIDATES = 16
"""Random pairs of points for each that is taught."""


@dataclass(frozen=True)
class Amounts:
    """How much of rooms a batch holds.

    Attributes:
        seen, predicted: points of a view.
        pairs: ordered pairs of views in each room, if there are as many.
        relations: point pairs of each, a multiple of 4.
    """

    seen: int
    predicted: int
    pairs: int
    relations: int


def relation_batch(
    rooms: Sequence[RelationRoom], amounts: Amounts, tilt_deg: float, rng: np.random.Generator
) -> Batch:
    """All views of some rooms, S in all, with N points each, and Q pairs of views.

    Args:
        rooms: where the views are.
        amounts: how much is drawn.
        tilt_deg: standard deviation of the error of the level frame about each horizontal axis.
        rng: draws all of it.

    Returns:
        what `RelationScans` and `PosedPairs` name, the poses perturbed;
        ``true_points``, ``true_normals`` (S, N, 3) of the surface in the points' directions, and
        ``semantics`` (S, N) its classes; ``true_pose`` (Q, 4, 4);
        ``relation`` (Q, M) the true `Relation` of each point pair, every class as often as the
        others, and ``known`` (Q, M), False in rows of a class that two views do not have.
    """
    views = {
        f.name: np.concatenate([getattr(r, f.name) for r in rooms]) for f in fields(RelationRoom)
    }
    rows = _chosen_rows(amounts, rng)
    count = len(views["points"])
    tilts = se3.rotation_exp(np.radians(rng.normal(0, tilt_deg, (count, 3))) * [1, 1, 0])
    frames = se3.pose(tilts, np.zeros((count, 3))) @ views["level_T_world"]
    pairs = _view_pairs([len(room.points) for room in rooms], amounts.pairs, rng)
    true_poses = frames[pairs[:, 1]] @ se3.inverse(frames[pairs[:, 0]])
    target_T_source = [perturbed(pose, rng) for pose in true_poses]
    truth = _Truth(
        views["true_points"][:, rows].astype(np.float64),
        views["true_normals"][:, rows].astype(np.float64),
        views["valid"][:, rows],
        views["level_T_world"],
    )
    drawn = [truth.relations(a, b, amounts.relations, rng) for a, b in pairs]
    source_point, target_point, relation, known = (np.stack(c) for c in zip(*drawn, strict=True))
    arrays = {
        **_inputs(views, rows, tilts),
        "source": pairs[:, 0],
        "target": pairs[:, 1],
        "target_T_source": np.stack(target_T_source).astype(np.float32),
        "true_pose": true_poses.astype(np.float32),
        "true_points": views["true_points"][:, rows] @ _back(tilts),
        "true_normals": views["true_normals"][:, rows] @ _back(tilts),
        "source_point": source_point,
        "target_point": target_point,
        "semantics": (views["semantics"] * views["valid"])[:, rows].astype(np.int64),
        "relation": relation,
        "known": known,
    }
    return {name: torch.from_numpy(array) for name, array in arrays.items()}


@dataclass(frozen=True)
class _Truth:
    """Of S views: points and normals (S, N, 3) in their level frames, which are valid (S, N), and
    level_T_world (S, 4, 4)."""

    points: Array
    normals: Array
    valid: BoolArray
    level_T_world: Array

    def relations(
        self, a: int, b: int, count: int, rng: np.random.Generator
    ) -> tuple[IntArray, IntArray, IntArray, BoolArray]:
        """Points (M,) of two views, their relations (M,), and which of them there are (M,)."""
        i, j = rng.integers(self.points.shape[1], size=(2, CANDIDATES * count))
        labels = true_relations(
            self.points[a, i],
            self.normals[a, i],
            self.points[b, j],
            self.normals[b, j],
            self.level_T_world[b] @ se3.inverse(self.level_T_world[a]),
        )
        there = self.valid & (np.linalg.norm(self.normals, axis=-1) > 0.5)
        chosen, known = balanced(labels, there[a, i] & there[b, j], count, rng)
        return i[chosen], j[chosen], labels[chosen], known


def balanced(
    labels: IntArray, allowed: BoolArray, count: int, rng: np.random.Generator
) -> tuple[IntArray, BoolArray]:
    """Draw indices of labels, each `Relation` equally often.

    Args:
        labels: (C,) values of `Relation`.
        allowed: (C,) which may be drawn.
        count: M, a multiple of 4.
        rng: draws; a class with too few labels repeats them.

    Returns:
        (M,) indices, and which of them are of their class; the others' class does not occur.
    """
    share = count // len(Relation)
    chosen, known = [], []
    for relation in Relation:
        where = np.flatnonzero(allowed & (labels == relation))
        known.append(np.full(share, len(where) > 0))
        chosen.append(rng.choice(where if len(where) else np.arange(1), share))
    return np.concatenate(chosen), np.concatenate(known)


def _chosen_rows(amounts: Amounts, rng: np.random.Generator) -> IntArray:
    """(N,) of the points that are kept of every view, in the order in which they were drawn."""
    seen, further = rng.permutation(SEEN)[: amounts.seen], rng.permutation(PREDICTED)
    return np.concatenate([seen, SEEN + further[: amounts.predicted]])


def _view_pairs(views: Sequence[int], most: int, rng: np.random.Generator) -> IntArray:
    """(Q, 2) ordered pairs of views of the same room, at most so many of each."""
    pairs, first = [], 0
    for count in views:
        own = np.array(list(itertools.permutations(range(first, first + count), 2)))
        pairs.append(rng.permutation(own)[:most])
        first += count
    return np.concatenate(pairs)


def _inputs(views: dict[str, np.ndarray], rows: IntArray, tilts: Array) -> dict[str, np.ndarray]:
    """What `RelationScans` names, out of what a sensor and a network give."""
    back = _back(tilts)
    predicted = views["predicted"][:, rows]
    colours = views["colours"][:, rows].astype(np.float32) / np.float32(255.0)
    return {
        "points": views["points"][:, rows] @ back,
        "normals": views["normals"][:, rows] @ back,
        "colours": np.where(predicted[..., None], np.float32(GREY), colours),
        "confidence": views["confidence"][:, rows],
        "predicted": predicted,
        "pooled": views["valid"][:, rows],
        "pixels": views["pixels"][:, rows].astype(np.int64),
        "ring_colour": views["ring_colour"],
        "ring_depth": views["ring_depth"],
    }


def _back(tilts: Array) -> FloatArray:
    """(S, 3, 3) rotations for row vectors."""
    return tilts.astype(np.float32).swapaxes(1, 2)
