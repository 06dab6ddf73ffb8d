"""The same place in the layouts of two cameras: contrast of the cells' descriptors."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from fewview.completion.layout.grid import FREE, HALF_M, UNKNOWN, cell_centres
from fewview.geometry import se3
from fewview.training import losses
from fewview.training.point_batches import neighbours
from fewview.training.problem import Batch
from fewview.types import Array, FloatArray

RIGHT_M = 0.25


def cell_matches(
    layout: NDArray[np.uint8],
    room: NDArray[np.int64],
    frame_T_world: Array,
    count: int,
    rng: np.random.Generator,
) -> dict[str, Tensor]:
    """Pair each camera with the next one of its room and choose ``count`` cells of things.

    Args:
        layout: (B, G, G).
        room: (B,) ascending.
        frame_T_world: (B, 4, 4).
        count: M, cells per pair.
        rng: chooses them.

    Returns:
        ``match_source``, ``match_target`` (P,) cameras; ``match_cell`` (P, M) flat cell in the
        source; ``match_place`` (P, M, 2) the same places in the target's frame, metres;
        ``match_valid`` (P, M) bool, inside the target's grid.
    """
    pairs = neighbours(room)
    centres = cell_centres().reshape(-1, 2)
    cells = np.zeros((len(pairs), count), np.int64)
    places = np.zeros((len(pairs), count, 2), np.float32)
    valid = np.zeros((len(pairs), count), bool)
    for i, (a, b) in enumerate(pairs):
        target_T_source = frame_T_world[b] @ se3.inverse(frame_T_world[a])
        moved = _moved(target_T_source, centres)
        inside = np.abs(moved).max(axis=1) < HALF_M
        things = (layout[a].ravel() != FREE) & (layout[a].ravel() != UNKNOWN)
        chosen = rng.permutation(np.flatnonzero(inside & things))[:count]
        cells[i, : len(chosen)], places[i, : len(chosen)] = chosen, moved[chosen]
        valid[i, : len(chosen)] = True
    index = np.array(pairs, np.int64).reshape(-1, 2)
    named = {
        "match_source": index[:, 0],
        "match_target": index[:, 1],
        "match_cell": cells,
        "match_place": places,
        "match_valid": valid,
    }
    return {name: torch.from_numpy(array) for name, array in named.items()}


def match_loss(descriptors: Tensor, batch: Batch) -> Tensor:
    """How badly matched cells find each other among the chosen ones; see `losses.info_nce`.

    Args:
        descriptors: (B, D, G, G) unit length.
        batch: see `cell_matches`.
    """
    source, target = _compared(descriptors, batch)
    on_floor = F.pad(batch["match_place"], (0, 1))
    return losses.info_nce(source, target, on_floor, batch["match_valid"])


def match_recall(descriptors: Tensor, seen: Tensor, batch: Batch) -> dict[str, float]:
    """Share of cells whose 1 or 5 most alike places in the other camera hold one within 0.25 m.

    Counted apart for cells seen by both cameras (``oo``), by one (``op``) and by none (``pp``).
    The candidates are the chosen cells of the pair; ``match_chance_1`` is what luck would give.

    Args:
        descriptors: (B, D, G, G) unit length.
        seen: (B, G, G) bool.
        batch: see `cell_matches`.
    """
    source, target = _compared(descriptors, batch)
    valid = batch["match_valid"]
    logits = (source @ target.mT).masked_fill(~valid[:, None], -2.0)
    near = torch.cdist(batch["match_place"], batch["match_place"]) < RIGHT_M
    near &= valid[:, None]
    order = logits.topk(min(5, logits.shape[-1]), dim=-1).indices
    hits = near.gather(-1, order)
    here = seen.flatten(1)[batch["match_source"][:, None], batch["match_cell"]]
    there = _sampled(seen[:, None].float(), batch)[..., 0] > 0.5
    both, none = here & there & valid, ~here & ~there & valid
    groups = {"oo": both, "op": valid & ~both & ~none, "pp": none}
    out: dict[str, float] = {}
    for name, group in groups.items():
        if bool(group.any()):
            out[f"match_{name}_1"] = float(hits[group][:, 0].float().mean())
            out[f"match_{name}_5"] = float(hits[group].any(dim=-1).float().mean())
    share = near.sum(dim=-1) / valid.sum(dim=-1, keepdim=True).clamp(min=1)
    out["match_chance_1"] = float(share[valid].mean()) if bool(valid.any()) else 0.0
    return out


def _compared(descriptors: Tensor, batch: Batch) -> tuple[Tensor, Tensor]:
    """(P, M, D) descriptors of the cells and of the same places in the other camera."""
    flat = descriptors.flatten(2).mT
    source = flat[batch["match_source"][:, None], batch["match_cell"]]
    return source, F.normalize(_sampled(descriptors, batch), dim=-1)


def _sampled(images: Tensor, batch: Batch) -> Tensor:
    """(P, M, C) values of images (B, C, G, G) at the places, bilinear."""
    row_column = -batch["match_place"] / HALF_M
    at = row_column.flip(-1)[:, :, None]
    found = F.grid_sample(images[batch["match_target"]], at, align_corners=False)
    return found[..., 0].mT


def _moved(target_T_source: Array, places: FloatArray) -> FloatArray:
    flat = places @ target_T_source[:2, :2].T + target_T_source[:2, 3]
    return np.asarray(flat, dtype=np.float32)
