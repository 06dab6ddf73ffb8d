"""Phase three of the training: networks and hyper-parameters together (Sec. 3.4).

    l = l_1 + lambda_2 l_2 + lambda_3 l_3 + lambda_4 l_4

l_1 is the completion of the 360-image where points of it are used, l_2 the relations of point
pairs, l_3 the spectral loss of matched descriptors, l_4 that of the regression. Predicted points
are those of the network as it is now, so that all four reach it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from fewview import weights
from fewview.completion.panorama.features import SCALES
from fewview.completion.panorama.network import PanoramaNetwork
from fewview.config import RefinementConfig
from fewview.refinement.learned_relations import NAME as RELATION
from fewview.refinement.learned_relations import network_of as relation_network
from fewview.refinement.relation_network import RelationNetwork
from fewview.training import joint_pairs, losses
from fewview.training.foreseen import Foreseen, foreseen
from fewview.training.joint_pairs import KIND
from fewview.training.problem import Batch, Problem
from fewview.training.regression_energy import SCALES as ALPHAS
from fewview.training.regression_energy import scales_of
from fewview.training.regression_loss import regression_loss
from fewview.training.relation import RelationProblem, given
from fewview.training.relation_rooms import RelationRoom, panorama_network
from fewview.training.rooms import RoomSource
from fewview.training.spectral_loss import gammas_of, spectral_loss

SEMANTICS = 0.3
"""Of the classes' cross-entropy in l_1, as where the 360-image network is trained alone."""


class JointNetwork(nn.Module):
    """The networks, and the logarithms of the hyper-parameters between them."""

    def __init__(self, panorama: PanoramaNetwork, relation: RelationNetwork) -> None:
        super().__init__()
        self.panorama, self.relation = panorama, relation
        self.log_gammas = nn.Parameter(gammas_of({KIND: SCALES})[KIND].log())
        alphas = scales_of(RefinementConfig())
        self.log_alphas = nn.Parameter(torch.stack([alphas[name].log() for name in ALPHAS]).float())

    def gammas(self) -> dict[str, Tensor]:
        """Of the descriptors' kind; see `spectral_loss`."""
        return {KIND: self.log_gammas.exp()}

    def alphas(self) -> dict[str, Tensor]:
        """See `regression_energy`."""
        return dict(zip(ALPHAS, self.log_alphas.double().exp(), strict=True))


@dataclass(frozen=True)
class JointProblem(Problem):
    """Fine-tune the 360-image and the relation network with what ties them together."""

    relation: RelationProblem = field(default_factory=lambda: RelationProblem(tilt_deg=0.0))
    """What l_2 is, and how much a batch holds; level frames have to be exact."""
    lambda_2: float = 1.0
    """Of the relations."""
    lambda_3: float = 0.3
    """Of the spectral loss."""
    lambda_4: float = 1.0
    """Of the regression."""
    pairs: int = 4
    """Pairs of views of a batch for the last of them."""
    weights: str = ""
    """Folder of the weights to begin with; empty for the shipped ones."""
    name: str = "joint"
    """Of the weights."""

    @property
    def folder(self) -> Path:
        """Where the weights to begin with are."""
        return weights.folder_of(self.weights)

    def network(self) -> nn.Module:
        relation = weights.shipped(RELATION, relation_network, self.folder)
        return JointNetwork(panorama_network(self.folder), relation)

    def prepared(self, rooms: RoomSource) -> RoomSource:
        return self.relation.prepared(rooms)

    def preparation(self) -> str:
        return self.relation.preparation()

    def mirrored(self, room: RelationRoom) -> RelationRoom:
        return self.relation.mirrored(room)

    def batch(self, rooms: Sequence[RelationRoom], rng: np.random.Generator) -> Batch:
        """That of the relations."""
        return self.relation.batch(rooms, rng)

    def losses(self, network: nn.Module, batch: Batch) -> Batch:
        assert isinstance(network, JointNetwork)
        scans, pairs = given(batch)
        seen = foreseen(network.panorama, scans)
        output = network.relation(seen.scans, pairs)
        relation = self.relation.losses_of(output, batch)
        spectral = [
            spectral_loss(problem, network.gammas())
            for problem in joint_pairs.spectral_problems(seen, batch)
        ]
        fixed = {"match_weight": torch.ones((), dtype=torch.float64)}
        regression = [
            regression_loss(problem, {**network.alphas(), **fixed})
            for problem in joint_pairs.regression_problems(
                seen, output, batch, min(self.pairs, len(pairs.source))
            )
        ]
        return {
            "completion": self._completion(seen, batch),
            "relation": self.lambda_2 * torch.stack(list(relation.values())).sum(),
            "spectral": self.lambda_3 * _mean(spectral, seen.log_depth),
            "regression": self.lambda_4 * _mean(regression, seen.log_depth),
        }

    def _completion(self, seen: Foreseen, batch: Batch) -> Tensor:
        """l_1 of the predicted points."""
        where = batch["predicted"] & (batch["semantics"] > 0)
        weight = where.to(seen.log_depth.dtype)
        error = (seen.log_depth - joint_pairs.log_depth(batch["true_points"])).abs()
        normal = losses.normal_error(seen.scans.normals.mT, batch["true_normals"].mT)
        classes = torch.tensor(self.relation.class_weights, device=weight.device)
        labels = torch.where(where, batch["semantics"], 0)
        return (
            losses.weighted_mean(error, weight)
            + losses.weighted_mean(normal, weight)
            + SEMANTICS * losses.semantics(seen.semantics.mT, labels, classes)
        )

    def metrics(self, network: nn.Module, batch: Batch) -> dict[str, float]:
        """The four losses by themselves, and what is measured of the relations."""
        assert isinstance(network, JointNetwork)
        seen = foreseen(network.panorama, given(batch)[0])
        live = {**batch, **seen.scans._asdict()}
        scale = (1.0, self.lambda_2, self.lambda_3, self.lambda_4)
        parts = self.losses(network, batch).items()
        alone = {
            f"{name}_loss": float(value) / factor if factor else float("nan")
            for (name, value), factor in zip(parts, scale, strict=True)
        }
        where = batch["predicted"] & (batch["semantics"] > 0)
        error = (seen.log_depth - joint_pairs.log_depth(batch["true_points"])).abs()[where]
        return {
            **alone,
            "log_depth": float(error.mean()),
            **self.relation.metrics(network.relation, live),
        }


def _mean(values: list[Tensor], like: Tensor) -> Tensor:
    """Mean of scalars, 0 of none, in the type of another tensor."""
    return torch.stack(values).mean().to(like.dtype) if values else like.sum() * 0.0
