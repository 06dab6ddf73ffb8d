"""The aligner as a training problem: where one view of a room lies in another's drawing."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import cast

import numpy as np
import torch
from torch import Tensor, nn

from fewview.alignment import AlignerNetwork, AlignerNetworkConfig, Drawing, joint_drawing
from fewview.alignment.align import MAX_YAW, QUARTER
from fewview.alignment.network import GRID, STEP_M, YAWS, shifts
from fewview.training import losses
from fewview.training.drawn_rooms import DrawnProblem, DrawnRoom, DrawnRooms
from fewview.training.problem import Batch
from fewview.types import IntArray

TOP = 5


@dataclass(frozen=True)
class AlignerProblem(DrawnProblem):
    """Find the yaw and the shift between all views of a room."""

    size: AlignerNetworkConfig = field(default_factory=AlignerNetworkConfig)
    """Of the network."""
    blur_m: float = 0.15
    """Standard deviation of the shift that is taught as true."""
    apart: float = 2.0
    """What pairs count that share less than a tenth of their surface, against others."""
    turn: float = 0.5
    """Of the cross-entropy of the true yaw, whatever the shift."""
    joint: int = 4
    """Views of a room that take part a second time, drawn together with others."""
    together: int = 3
    """The most others that are drawn together with one."""
    name: str = "aligner"
    """Of the weights."""

    def network(self) -> nn.Module:
        return AlignerNetwork(self.size)

    def batch(self, rooms: Sequence[DrawnRoom], rng: np.random.Generator) -> Batch:
        """``drawing`` (B, CHANNELS, CELLS, CELLS) and its ``room`` (B,) of all views, then of views
        drawn together with others. Room by room all ordered pairs that show no view both:
        ``source``, ``target`` (P,); ``yaw`` (P,) true quarter turns, ``shift`` (P, 2) metres,
        ``apart`` (P,) whether they share hardly any surface, ``joint`` (P,) whether one of them
        shows several views, ``away`` (P,) the quarter turns that make the cameras face away from
        each other. Pairs whose walls are not parallel or that are out of reach are left out."""
        drawn = DrawnRooms(rooms)
        views = len(drawn.drawings)
        groups = [(view,) for view in range(views)] + self._groups(drawn.room, rng)
        shown = [joint_view(drawn, group) for group in groups]
        room = drawn.room[[group[0] for group in groups]]
        index = np.argwhere(room[:, None] == room)
        index = index[np.argsort(room[index[:, 0]], kind="stable")]
        index = np.array([(a, b) for a, b in index if not {*groups[a]} & {*groups[b]}])
        first = np.array([group[0] for group in groups])
        source, target = first[index].T
        motion = np.concatenate([drawn.motion(a, b) for a, b in zip(source, target, strict=True)])
        turns = np.rint(motion[:, 0] / QUARTER)
        usable = np.abs(motion[:, 0] - turns * QUARTER) < MAX_YAW
        usable &= (np.abs(motion[:, 1:]) < (GRID - 1) * STEP_M).all(axis=1)
        heading = np.array([_heading(d.level_T_scan) for d in drawn.drawings])
        away = heading[target] + np.pi - heading[source]

        def apart(a: Sequence[int], b: Sequence[int]) -> bool:
            return all(drawn.apart(i, j) for i, j in itertools.product(a, b))

        columns = {
            "source": index[:, 0],
            "target": index[:, 1],
            "yaw": turns.astype(np.int64) % YAWS,
            "shift": motion[:, 1:],
            "apart": np.array([apart(groups[a], groups[b]) for a, b in index]),
            "joint": (index >= views).any(axis=1),
            "away": np.rint(away / QUARTER).astype(np.int64) % YAWS,
        }
        kept = {name: torch.from_numpy(values[usable]) for name, values in columns.items()}
        drawings = np.stack([drawing.channels for drawing in shown])
        return {"drawing": torch.from_numpy(drawings), "room": torch.from_numpy(room), **kept}

    def _groups(self, room: IntArray, rng: np.random.Generator) -> list[tuple[int, ...]]:
        """Of every room, `joint` views, each with up to `together` others."""
        out = []
        for number in np.unique(room):
            views = np.flatnonzero(room == number)
            for first in rng.permutation(views)[: self.joint]:
                others = rng.permutation(views[views != first])
                out.append((first, *others[: rng.integers(1, self.together + 1)]))
        return out

    def losses(self, network: nn.Module, batch: Batch) -> dict[str, Tensor]:
        """The cross-entropies of the true pose and of its yaw alone."""
        logits = _logits(network, batch)
        log_chance = logits.flatten(1).log_softmax(dim=1).view_as(logits)
        log_chance = log_chance[torch.arange(len(logits)), batch["yaw"]]
        turn = -log_chance.flatten(1).logsumexp(dim=1)
        at = shifts().to(logits.device)
        along = [_blurred(batch["shift"][:, axis, None] - at, self.blur_m) for axis in (0, 1)]
        taught = along[0][:, :, None] * along[1][:, None, :]
        loss = -(taught * log_chance).sum(dim=(1, 2))
        weight = torch.where(batch["apart"], self.apart, 1.0)
        return {
            "pose": losses.weighted_mean(loss, weight),
            "turn": self.turn * losses.weighted_mean(turn, weight),
        }

    def metrics(self, network: nn.Module, batch: Batch) -> dict[str, float]:
        """Mean error of the yaw, median error of the shift, and share within 0.3 m of the first
        pose and of the best of the first five; beside the most probable yaw whatever the shift,
        and cameras facing away."""
        logits = _logits(network, batch)
        likely = logits.flatten(2).logsumexp(dim=2).argmax(dim=1)
        wrong = 90.0 * _between(torch.arange(YAWS)[None], batch["yaw"][:, None]).float()
        first, found = _peaks(logits)
        yaw_error = wrong.gather(1, first)
        error = (found - batch["shift"][:, None]).norm(dim=-1)
        right_yaw = yaw_error == 0
        joint = torch.where(right_yaw, error, 9.0)
        away = wrong.gather(1, batch["away"][:, None])[:, 0]
        turned = wrong.gather(1, likely[:, None])[:, 0]
        out: dict[str, float] = {}
        apart, joint_target = batch["apart"], batch["joint"]
        parts = {
            "apart": apart & ~joint_target,
            "sharing": ~apart & ~joint_target,
            "joint_apart": apart & joint_target,
        }
        for part, where in parts.items():
            if not bool(where.any()):
                continue
            out[f"{part}_away_deg"] = float(away[where].mean())
            out[f"{part}_yaw_deg"] = float(turned[where].mean())
            for name, count in (("top1", 1), (f"top{TOP}", TOP)):
                best = joint[where, :count].amin(dim=1)
                out[f"{part}_{name}_deg"] = float(yaw_error[where, :count].amin(dim=1).mean())
                out[f"{part}_{name}_m"] = float(error[where, :count].amin(dim=1).median())
                out[f"{part}_{name}_right"] = float((best < 0.3).float().mean())
                out[f"{part}_{name}_near"] = float((best < 0.6).float().mean())
        return out


def _logits(network: nn.Module, batch: Batch) -> Tensor:
    aligner = cast(AlignerNetwork, network)
    spectra = aligner(batch["drawing"])
    room, source, target = batch["room"], batch["source"], batch["target"]
    out = []
    for number in range(int(room.max()) + 1):
        pairs = room[source] == number
        sources, row = torch.unique(source[pairs], return_inverse=True)
        targets, column = torch.unique(target[pairs], return_inverse=True)
        maps = aligner.logits(spectra.source[sources], spectra.target[targets])
        out.append(maps.flatten(0, 1)[row * len(targets) + column])
    return torch.cat(out)


def joint_view(drawn: DrawnRooms, group: Sequence[int]) -> Drawing:
    """Views of a room drawn together on the grid of the first."""
    first, *others = group
    poses = [drawn.target_T_source(other, first) for other in others]
    drawings = [drawn.drawings[other] for other in others]
    return joint_drawing(drawn.drawings[first], drawings, np.reshape(poses, (-1, 4, 4)))


def _peaks(logits: Tensor) -> tuple[Tensor, Tensor]:
    """Yaws (P, TOP) and shifts (P, TOP, 2) of the highest maxima."""
    pooled = nn.functional.max_pool2d(logits, 5, stride=1, padding=2)
    flat = logits.masked_fill(logits < pooled, -torch.inf).flatten(1).topk(TOP, dim=1).indices
    size = logits.shape[-1]
    at = shifts().to(logits.device)
    places = torch.stack([at[flat // size % size], at[flat % size]], dim=-1)
    return flat // size**2, places


def _blurred(distance: Tensor, blur: float) -> Tensor:
    weight = torch.exp(-0.5 * (distance / blur) ** 2)
    return weight / weight.sum(dim=1, keepdim=True).clamp_min(1e-9)


def _between(a: Tensor, b: Tensor) -> Tensor:
    """Quarter turns from one to the other, 0, 1 or 2."""
    turns = (a - b) % YAWS
    return torch.minimum(turns, YAWS - turns)


def _heading(level_T_scan: np.ndarray) -> float:
    """Azimuth of the x axis of a level frame in the grid's."""
    return float(np.arctan2(level_T_scan[1, 0], level_T_scan[0, 0]))
