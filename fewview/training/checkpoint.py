"""Where a run stands, on disk: enough to go on as if it had never stopped."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import nn

from fewview.errors import FewviewError

Point = dict[str, float]
MAY_CHANGE = {"steps", "store", "log_every", "checkpoint_minutes"}


@dataclass
class State:
    """Progress of a run beside its weights.

    Attributes:
        step: batches done.
        seconds: wall time spent.
        best: lowest validation loss so far.
        curves: points of the training and the validation curves.
    """

    step: int = 0
    seconds: float = 0.0
    best: float = math.inf
    curves: dict[str, list[Point]] = field(
        default_factory=lambda: {"training": [], "validation": []}
    )


def save(
    path: Path,
    state: State,
    network: nn.Module,
    optimiser: torch.optim.Optimizer,
    config: dict[str, Any],
) -> None:
    """Write a checkpoint, whole or not at all."""
    partial = path.with_suffix(".part")
    values = {
        "state": vars(state),
        "network": network.state_dict(),
        "optimiser": optimiser.state_dict(),
        "torch_rng": torch.get_rng_state(),
        "config": config,
    }
    torch.save(values, partial)
    partial.replace(path)


def restore(
    path: Path,
    network: nn.Module,
    optimiser: torch.optim.Optimizer,
    config: dict[str, Any],
) -> State:
    """Read a checkpoint into a network and its optimiser.

    Raises:
        FewviewError: there is none, or it was made with other settings.
    """
    if not path.is_file():
        raise FewviewError(f"{path}: no checkpoint to resume; leave out --resume to begin")
    values = torch.load(path, map_location="cpu", weights_only=True)
    stored = values["config"]
    if changed := [k for k in config if k not in MAY_CHANGE and config[k] != stored.get(k)]:
        raise FewviewError(f"{path}: made with another '{changed[0]}'; choose another --out")
    network.load_state_dict(values["network"])
    optimiser.load_state_dict(values["optimiser"])
    torch.set_rng_state(values["torch_rng"])
    return State(**values["state"])


def write_curves(path: Path, state: State) -> None:
    """The curves as JSON, figures that are no numbers left out."""
    tidy = {
        name: [{k: v for k, v in point.items() if math.isfinite(v)} for point in points]
        for name, points in state.curves.items()
    }
    partial = path.with_suffix(".part")
    partial.write_text(json.dumps(tidy, indent=1, allow_nan=False) + "\n")
    partial.replace(path)
