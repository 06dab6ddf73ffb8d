"""The verifier as a training problem: candidates of pairs of scans, drawn together, right or wrong.

The wrong ones are the aligner's own, in rooms that neither it nor the layout network learnt from,
and poses close to the true one.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from fewview import weights
from fewview.alignment import AlignerNetwork, Alignment, embed, planar_motion
from fewview.alignment.align import NAME as ALIGNER
from fewview.alignment.align import aligner_of
from fewview.training.drawn_rooms import (
    Draughtsman,
    DrawnRoom,
    DrawnRooms,
    drawing_fingerprint,
    mirrored,
)
from fewview.training.problem import Batch, Problem
from fewview.types import Array, BoolArray, FloatArray
from fewview.verification.network import VerifierNetwork, VerifierNetworkConfig, together

if TYPE_CHECKING:
    from fewview.training.rooms import RoomSource

RIGHT_RAD, RIGHT_M = float(np.radians(15.0)), 0.3
JITTER_RAD, JITTER_M = float(np.radians(3.0)), 0.1
MISS_M = (0.4, 1.5)


@dataclass(frozen=True)
class VerifierProblem(Problem):
    """Tell the right pose of two scans from those that also look like a room."""

    size: VerifierNetworkConfig = field(default_factory=VerifierNetworkConfig)
    """Of the network."""
    weights: str = ""
    """Folder of the layout network's and the aligner's weights, empty for the shipped ones."""
    tilt_deg: float = 1.0
    """Standard deviation of the error of the level frame about each horizontal axis."""
    pairs: int = 16
    """Pairs of views in each room."""
    candidates: int = 6
    """Proposals looked at per pair, best score first; two more are made from the true pose."""
    hidden: float = 0.3
    """Share of training pairs whose right candidates are left out, so that none is right."""
    name: str = "verifier"
    """Of the weights."""

    def network(self) -> nn.Module:
        return VerifierNetwork(self.size)

    def prepared(self, rooms: RoomSource) -> RoomSource:
        return Draughtsman(rooms, self.weights, self.tilt_deg)

    def preparation(self) -> str:
        return drawing_fingerprint(self.weights, self.tilt_deg)

    def mirrored(self, room: DrawnRoom) -> DrawnRoom:
        return mirrored(room)

    def batch(self, rooms: Sequence[DrawnRoom], rng: np.random.Generator) -> Batch:
        """``drawing`` (B, CHANNELS, CELLS, CELLS); ``source``, ``target`` (P,) which of them;
        ``motion`` (P, K, 3), ``right``, ``asked`` (P, K), the candidates, best score first and the
        true pose with a near miss last; ``apart`` (P,) whether they share hardly any surface;
        ``turn`` () quarter turns in which they are drawn."""
        drawn = DrawnRooms(rooms)
        aligner = _aligner(self.weights)
        scans = [embed(drawing, aligner) for drawing in drawn.drawings]
        columns: dict[str, list[np.ndarray]] = {}
        for room in range(len(rooms)):
            views = np.flatnonzero(drawn.room == room)
            pairs = np.array(list(itertools.permutations(views, 2)))
            for a, b in pairs[rng.permutation(len(pairs))[: self.pairs]]:
                true = drawn.target_T_source(a, b)
                motion, right = self._candidates(Alignment(scans[a], scans[b], aligner), true, rng)
                asked = np.ones(len(right), bool)
                if rng.random() < self.hidden:
                    asked &= ~right
                row = {
                    "source": a,
                    "target": b,
                    "motion": motion,
                    "right": right,
                    "asked": asked,
                    "apart": drawn.apart(a, b),
                }
                for name, value in row.items():
                    columns.setdefault(name, []).append(np.asarray(value))
        return {
            "drawing": torch.from_numpy(np.stack([d.channels for d in drawn.drawings])),
            "turn": torch.tensor(int(rng.integers(4))),
            **{name: torch.from_numpy(np.stack(rows)) for name, rows in columns.items()},
        }

    def losses(self, network: nn.Module, batch: Batch) -> dict[str, Tensor]:
        """The likelihood of the right candidates, or of none where none is right."""
        turns = int(batch["turn"]) if network.training else 0
        logits = _logits(network, batch, turns)
        every = F.pad(logits, (1, 0), value=0.0)
        asked = F.pad(batch["asked"], (1, 0), value=True)
        right = asked & F.pad(batch["right"], (1, 0), value=False)
        right[:, 0] = ~right.any(dim=1)
        chance = every.masked_fill(~asked, -torch.inf).logsumexp(dim=1)
        return {"choice": (chance - every.masked_fill(~right, -torch.inf).logsumexp(dim=1)).mean()}

    def metrics(self, network: nn.Module, batch: Batch) -> dict[str, float]:
        """Share of pairs whose first candidate is right by score and by the network, of those
        that have a right one; and mean error of the yaw; for pairs apart and others."""
        logits = _logits(network, batch, 0)[:, : self.candidates]
        right, motion = batch["right"][:, : self.candidates], batch["motion"]
        true_yaw = motion[:, -2, 0]
        out: dict[str, float] = {}
        chosen = {"score": torch.zeros_like(logits[:, 0]).long(), "verified": logits.argmax(dim=1)}
        for part, where in (("apart", batch["apart"]), ("sharing", ~batch["apart"])):
            out[f"{part}_proposed"] = _mean(right.any(dim=1), where)
            for name, pick in chosen.items():
                hit = right.gather(1, pick[:, None])[:, 0]
                yaw = motion[:, :, 0].gather(1, pick[:, None])[:, 0] - true_yaw
                error = torch.rad2deg(torch.atan2(yaw.sin(), yaw.cos()).abs())
                out[f"{part}_{name}"] = _mean(hit, where)
                out[f"{part}_{name}_yaw_deg"] = _mean(error, where)
        return out

    def _candidates(
        self, alignment: Alignment, true: Array, rng: np.random.Generator
    ) -> tuple[FloatArray, BoolArray]:
        """Motions (K, 3) and which are right."""
        proposed = alignment.best(self.candidates).target_T_source
        poses = np.concatenate([proposed, true[None]])
        at = planar_motion(alignment.source, alignment.target, poses)
        aside, angle = rng.uniform(*MISS_M), rng.uniform(0.0, 2.0 * np.pi)
        near = at[-1] + rng.normal(0.0, 1.0, 3) * [JITTER_RAD, JITTER_M, JITTER_M]
        miss = near + [0.0, aside * np.cos(angle), aside * np.sin(angle)]
        motion: Array = np.stack([*at[:-1], near, miss])
        yaw = motion[:, 0] - at[-1, 0]
        turn = np.abs(np.arctan2(np.sin(yaw), np.cos(yaw)))
        shift = np.linalg.norm(motion[:, 1:] - at[-1, 1:], axis=1)
        return motion.astype(np.float32), (turn < RIGHT_RAD) & (shift < RIGHT_M)


@cache
def _aligner(folder: str) -> AlignerNetwork:
    return weights.shipped(ALIGNER, aligner_of, Path(folder) if folder else weights.FOLDER)


def _logits(network: nn.Module, batch: Batch, turns: int) -> Tensor:
    """(P, K) of all candidates."""
    pairs, count = batch["right"].shape
    source, target = (
        batch["drawing"][batch[side]].repeat_interleave(count, dim=0)
        for side in ("source", "target")
    )
    drawn = together(source, target, batch["motion"].reshape(-1, 3))
    logits: Tensor = network(torch.rot90(drawn, turns, (2, 3)))
    return logits.reshape(pairs, count)


def _mean(values: Tensor, where: Tensor) -> float:
    return float(values[where].float().mean()) if bool(where.any()) else float("nan")
