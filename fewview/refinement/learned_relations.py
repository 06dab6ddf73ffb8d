"""Relations of planar patches by the trained relation network (Sec. 3.3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
import torch

from fewview import weights
from fewview.geometry import se3
from fewview.refinement.pair_geometry import PosedPairs
from fewview.refinement.relation_network import (
    RELATIONS,
    RelationNetwork,
    RelationNetworkConfig,
    RelationScans,
)
from fewview.refinement.relation_points import relation_points
from fewview.refinement.relations import PatchPairs, Relations
from fewview.types import Array, CompletedScan, IntArray

NAME = "relation"
SAMPLES = 8
"""Points of a patch, each paired with one of the other. The paper takes 6000 pairs of single
points, whose normals are noisier (Sec. 3.3)."""
SHARES = np.array([0.111, 0.110, 0.223, 0.556])
"""Of `RELATIONS` among random point pairs of training rooms; the network is trained on as many of
each."""


@cache
def shipped_network() -> RelationNetwork:
    """The network with the weights that come with the package.

    Raises:
        FewviewError: they are missing or damaged.
    """
    return weights.shipped(NAME, network_of)


def network_of(size: Mapping[str, Any]) -> RelationNetwork:
    """The network of a card's sizes."""
    return RelationNetwork(RelationNetworkConfig(**size))


class LearnedRelations:
    """A `RelationPredictor` that asks the network about points of the scans' planar patches.

    Args:
        network: the shipped one when not given.
        samples: points of a patch, over which the answers are averaged.
        seed: of everything drawn; the answer is a function of it and the arguments.
    """

    def __init__(
        self, network: RelationNetwork | None = None, samples: int = SAMPLES, seed: int = 0
    ) -> None:
        self.network = shipped_network() if network is None else network.eval()
        self.samples, self.seed = samples, seed

    def predict(
        self, source: CompletedScan, target: CompletedScan, target_T_source: Array
    ) -> Relations:
        """Relations of all pairs of patches, the classes as probable as random pairs have them."""
        pairs = PatchPairs.of(source, target)
        rng = np.random.default_rng(self.seed)
        asked = [points_on_patches(scan, self.samples, rng) for scan in (source, target)]
        rows = [
            (patch[:, None] * self.samples + np.arange(self.samples)).ravel()
            for patch in (pairs.source, pairs.target)
        ]
        chance = self._chance(source, target, target_T_source, asked, rows) * SHARES
        chance /= chance.sum(axis=-1, keepdims=True)
        size = (len(target_T_source), len(pairs.weight), self.samples, len(RELATIONS))
        mean = chance.reshape(size).mean(axis=2)
        return pairs.related(*np.moveaxis(mean[..., 1:], -1, 0))

    def of_surface(
        self,
        source: CompletedScan,
        target: CompletedScan,
        target_T_source: Array,
        source_index: IntArray,
        target_index: IntArray,
    ) -> Array:
        """(K, n, 4) probabilities of `RELATIONS` of given surface points.

        Args:
            source, target: the scans.
            target_T_source: (K, 4, 4).
            source_index, target_index: (n,) of their surface points, row i paired with row i.
        """
        rows = np.arange(len(source_index))
        asked = [source_index, target_index]
        return self._chance(source, target, target_T_source, asked, [rows, rows])

    def _chance(
        self,
        source: CompletedScan,
        target: CompletedScan,
        target_T_source: Array,
        asked: Sequence[IntArray],
        rows: Sequence[IntArray],
    ) -> Array:
        """(K, n, 4) probabilities of pairs of asked surface points: of either scan which points
        (m,) are asked about, and which of these (n,) make up the pairs."""
        if len(rows[0]) == 0 or len(target_T_source) == 0:
            return np.zeros((len(target_T_source), len(rows[0]), len(RELATIONS)))
        rng, poses = np.random.default_rng(self.seed), _level_poses(source, target, target_T_source)
        scans = [
            relation_points(scan, rng, index)
            for scan, index in zip((source, target), asked, strict=True)
        ]
        pairs = PosedPairs(
            torch.zeros(len(poses), dtype=torch.int64),
            torch.ones(len(poses), dtype=torch.int64),
            torch.from_numpy(poses.astype(np.float32)),
            *(torch.from_numpy(index).expand(len(poses), -1) for index in rows),
        )
        with torch.inference_mode():
            logits = self.network.relations(RelationScans.of(scans), pairs)
        return np.asarray(logits.softmax(dim=-1).numpy(), dtype=np.float64)


def points_on_patches(scan: CompletedScan, count: int, rng: np.random.Generator) -> IntArray:
    """(patches * count,) indices of random surface points, ``count`` of every patch of a scan."""
    order = np.argsort(scan.surface.labels, kind="stable")
    labels, patches = scan.surface.labels[order], np.arange(len(scan.patches))
    first = np.searchsorted(labels, patches)
    size = np.searchsorted(labels, patches, side="right") - first
    drawn = rng.integers(size[:, None], size=(len(patches), count))
    return np.asarray(order[first[:, None] + drawn].ravel(), np.int64)


def _level_poses(source: CompletedScan, target: CompletedScan, target_T_source: Array) -> Array:
    """Poses (K, 4, 4) between the level frames of the completed rooms."""
    scan_T_level = se3.inverse(source.room.level_T_scan)
    return np.asarray(target.room.level_T_scan @ target_T_source @ scan_T_level)
