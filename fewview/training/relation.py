"""The relation network as a training problem (Sec. 3.3; supplementary, "Training details")."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from fewview import weights
from fewview.evaluation.relations import Relation, read_relations
from fewview.refinement.pair_geometry import PosedPairs, picked
from fewview.refinement.relation_network import (
    RELATIONS,
    RelationNetwork,
    RelationNetworkConfig,
    RelationOutput,
    RelationScans,
)
from fewview.training import losses
from fewview.training.problem import Batch, Problem
from fewview.training.relation_batch import Amounts, relation_batch
from fewview.training.relation_rooms import (
    RelationRoom,
    Sampler,
    mirrored,
    sampling_fingerprint,
)
from fewview.training.rooms import RoomSource

RULES = {"rules": (15.0, 0.3), "wide_rules": (30.0, 1.0)}
"""Tolerances in degrees and metres of baselines that believe the perturbed pose."""


@dataclass(frozen=True)
class RelationProblem(Problem):
    """Name the relations of points of two scans under a pose that is not quite right."""

    size: RelationNetworkConfig = field(default_factory=RelationNetworkConfig)
    """Of the network."""
    seen: int = 768
    """Measured points of a view."""
    predicted: int = 256
    """Predicted points of a view."""
    pairs: int = 6
    """Ordered pairs of views in each room."""
    relations: int = 1024
    """Point pairs of each, a quarter of them of every class."""
    tilt_deg: float = 1.0
    """Standard deviation of the error of the level frame about each horizontal axis."""
    semantics: float = 0.2
    """Of the points' cross-entropy."""
    class_weights: tuple[float, ...] = (0.0, 0.4, 0.8, 0.6, 1.0, 1.1, 2.0, 2.5, 2.0, 3.0, 1.0, 1.0)
    """Of unknown, wall, floor, ceiling, door, window, table, chair, sofa, bed, cabinet, other."""
    weights: str = ""
    """Folder of the 360-image network's weights, which complete the rooms; empty for the shipped
    ones."""
    name: str = "relation"
    """Of the weights."""

    @property
    def folder(self) -> Path:
        """Where the 360-image network's weights are."""
        return weights.folder_of(self.weights)

    def network(self) -> nn.Module:
        return RelationNetwork(self.size)

    def prepared(self, rooms: RoomSource) -> RoomSource:
        return Sampler(rooms, self.folder)

    def preparation(self) -> str:
        return sampling_fingerprint(self.folder)

    def mirrored(self, room: RelationRoom) -> RelationRoom:
        return mirrored(room)

    def batch(self, rooms: Sequence[RelationRoom], rng: np.random.Generator) -> Batch:
        """Views, pairs of them under perturbed poses, and point pairs; see `relation_batch`."""
        amounts = Amounts(self.seen, self.predicted, self.pairs, self.relations)
        return relation_batch(rooms, amounts, self.tilt_deg, rng)

    def losses(self, network: nn.Module, batch: Batch) -> Batch:
        return self.losses_of(_output(network, batch), batch)

    def losses_of(self, output: RelationOutput, batch: Batch) -> Batch:
        """Cross-entropies of the relations and, as a side task, of the points' classes."""
        error = F.cross_entropy(output.relations.mT, batch["relation"], reduction="none")
        classes = torch.tensor(self.class_weights, device=error.device)
        return {
            "relation": losses.weighted_mean(error, batch["known"].to(error.dtype)),
            "semantics": self.semantics
            * losses.semantics(output.semantics.mT, _classes(batch), classes),
        }

    def metrics(self, network: nn.Module, batch: Batch) -> dict[str, float]:
        """Accuracies by class and their mean, for pairs of seen points and for those with a
        predicted one, beside those of `RULES`; and the accuracy of the points' classes."""
        output, truth = _output(network, batch), batch["relation"]
        answers = {"": output.relations.argmax(dim=-1)}
        answers |= {f"{name}_": _read(batch, *limits) for name, limits in RULES.items()}
        predicted = _any_predicted(batch)
        out: dict[str, float] = {}
        for part, where in (("seen", ~predicted), ("predicted", predicted)):
            for name, answer in answers.items():
                shares = [
                    _share(answer == truth, batch["known"] & where & (truth == relation))
                    for relation in Relation
                ]
                if not name:
                    out |= {f"{part}_{k}": v for k, v in zip(RELATIONS, shares, strict=True)}
                out[f"{part}_{name}mean"] = float(np.mean(shares))
        classes = _classes(batch)
        named = output.semantics[..., 1:].argmax(dim=-1) + 1
        return {**out, "semantics_accuracy": _share(named == classes, classes > 0)}


def given(batch: Batch) -> tuple[RelationScans, PosedPairs]:
    """The network's input out of named tensors."""
    scans = RelationScans(*(batch[name] for name in RelationScans._fields))
    return scans, PosedPairs(*(batch[name] for name in PosedPairs._fields))


def _output(network: nn.Module, batch: Batch) -> RelationOutput:
    output: RelationOutput = network(*given(batch))
    return output


def _classes(batch: Batch) -> Tensor:
    """(Q, 2 N) true classes of the sources' points, then of the targets'."""
    return torch.cat([batch["semantics"][batch[side]] for side in ("source", "target")], dim=1)


def _any_predicted(batch: Batch) -> Tensor:
    """(Q, M) point pairs of which at least one was not seen."""
    source, target = (
        picked(batch["predicted"][..., None], batch[side], batch[f"{side}_point"])[..., 0]
        for side in ("source", "target")
    )
    return source | target


def _read(batch: Batch, max_angle_deg: float, max_offset_m: float) -> Tensor:
    """(Q, M) relations read off what the network is given."""
    p, n, q, m = (
        picked(batch[name], batch[side], batch[f"{side}_point"]).double().cpu().numpy()
        for side in ("source", "target")
        for name in ("points", "normals")
    )
    poses = batch["target_T_source"].double().cpu().numpy()
    found = [
        read_relations(*arrays, max_angle_deg, max_offset_m)
        for arrays in zip(p, n, q, m, poses, strict=True)
    ]
    return torch.from_numpy(np.stack(found)).to(batch["relation"].device)


def _share(right: Tensor, where: Tensor) -> float:
    """Of the places that are right; not a number where there are none."""
    return float(right[where].float().mean())
