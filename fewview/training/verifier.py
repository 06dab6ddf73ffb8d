"""The verifier as a training problem: candidates of pairs of scans, drawn together, right or wrong.

They are the aligner's own, in rooms that the layout network did not learn from. A true pose among
them that the aligner did not find would teach the network to distrust the aligner.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from fewview import weights
from fewview.alignment import AlignerNetwork, Alignment, embed, planar_motion
from fewview.alignment.align import NAME as ALIGNER
from fewview.alignment.align import aligner_of
from fewview.training.drawn_rooms import DrawnProblem, DrawnRoom, DrawnRooms
from fewview.training.problem import Batch
from fewview.types import Array, BoolArray
from fewview.verification.network import VerifierNetwork, VerifierNetworkConfig, together

RIGHT_RAD, RIGHT_M = float(np.radians(15.0)), 0.3


@dataclass(frozen=True)
class VerifierProblem(DrawnProblem):
    """Tell the right pose of two scans from those that also look like a room."""

    size: VerifierNetworkConfig = field(default_factory=VerifierNetworkConfig)
    """Of the network."""
    pairs: int = 16
    """Pairs of views in each room."""
    candidates: int = 6
    """Proposals looked at per pair."""
    name: str = "verifier"
    """Of the weights."""

    def network(self) -> nn.Module:
        return VerifierNetwork(self.size)

    def batch(self, rooms: Sequence[DrawnRoom], rng: np.random.Generator) -> Batch:
        """``drawing`` (B, CHANNELS, CELLS, CELLS); ``source``, ``target`` (P,) which of them;
        ``motion`` (P, K, 3), ``score``, ``right`` (P, K), the candidates and what the aligner says
        of them, best first; ``yaw`` (P,) the true one; ``apart`` (P,) whether they share hardly
        any surface; ``turn`` () quarter turns in which they are drawn."""
        drawn = DrawnRooms(rooms)
        aligner = _aligner(self.folder)
        scans = [embed(drawing, aligner) for drawing in drawn.drawings]
        columns: dict[str, list[np.ndarray]] = {}
        for pairs in drawn.pairs():
            for a, b in pairs[rng.permutation(len(pairs))[: self.pairs]]:
                true = drawn.target_T_source(a, b)
                row = {
                    "source": a,
                    "target": b,
                    **self._candidates(Alignment(scans[a], scans[b], aligner), true),
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
        right = F.pad(batch["right"], (1, 0), value=False)
        right[:, 0] = ~right.any(dim=1)
        of_right = every.masked_fill(~right, -torch.inf).logsumexp(dim=1)
        return {"choice": (every.logsumexp(dim=1) - of_right).mean()}

    def metrics(self, network: nn.Module, batch: Batch) -> dict[str, float]:
        """Share of pairs whose first candidate is right by score and by the network, of those
        that have a right one; and mean error of the yaw; for pairs apart and others."""
        logits = _logits(network, batch, 0)
        right, motion = batch["right"], batch["motion"]
        out: dict[str, float] = {}
        chosen = {"score": torch.zeros_like(logits[:, 0]).long(), "verified": logits.argmax(dim=1)}
        for part, where in (("apart", batch["apart"]), ("sharing", ~batch["apart"])):
            out[f"{part}_proposed"] = _mean(right.any(dim=1), where)
            for name, pick in chosen.items():
                hit = right.gather(1, pick[:, None])[:, 0]
                yaw = motion[:, :, 0].gather(1, pick[:, None])[:, 0] - batch["yaw"]
                error = torch.rad2deg(torch.atan2(yaw.sin(), yaw.cos()).abs())
                out[f"{part}_{name}"] = _mean(hit, where)
                out[f"{part}_{name}_yaw_deg"] = _mean(error, where)
        return out

    def _candidates(self, alignment: Alignment, true: Array) -> dict[str, Array | BoolArray]:
        """``motion``, ``score`` and ``right`` of the aligner's best, and the true ``yaw``."""
        proposed = alignment.best(self.candidates)
        poses = np.concatenate([proposed.target_T_source, true[None]])
        motion = planar_motion(alignment.source, alignment.target, poses)
        yaw = motion[:-1, 0] - motion[-1, 0]
        turn = np.abs(np.arctan2(np.sin(yaw), np.cos(yaw)))
        shift = np.linalg.norm(motion[:-1, 1:] - motion[-1, 1:], axis=1)
        return {
            "motion": motion[:-1],
            "score": proposed.log_mass.astype(np.float32),
            "right": (turn < RIGHT_RAD) & (shift < RIGHT_M),
            "yaw": motion[-1, 0],
        }


@cache
def _aligner(folder: Path) -> AlignerNetwork:
    return weights.shipped(ALIGNER, aligner_of, folder)


def _logits(network: nn.Module, batch: Batch, turns: int) -> Tensor:
    """(P, K) of all candidates: what the network adds to the aligner's scores."""
    pairs, count = batch["right"].shape
    source, target = (
        batch["drawing"][batch[side]].repeat_interleave(count, dim=0)
        for side in ("source", "target")
    )
    drawn = together(source, target, batch["motion"].reshape(-1, 3))
    logits: Tensor = network(torch.rot90(drawn, turns, (2, 3)))
    return logits.reshape(pairs, count) + batch["score"]


def _mean(values: Tensor, where: Tensor) -> float:
    return float(values[where].float().mean()) if bool(where.any()) else float("nan")
