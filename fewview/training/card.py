"""What weights say about themselves: data, seed, steps, hardware, hours, figures, settings."""

from __future__ import annotations

import dataclasses
import math
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from fewview.synthetic import read_library
from fewview.training.settings import TrainConfig

FOLDERS = frozenset({"store", "library", "init", "weights"})
"""Settings that are folders."""
HISTORY = ("data", "seed", "steps", "hours", "sha256", "began_with")
"""What a card keeps of the one before it."""


def make_card(
    config: TrainConfig,
    step: int,
    seconds: float,
    validation: Mapping[str, float],
    device: torch.device,
    threads: int,
    before: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """The card of weights as they are after ``step`` steps and ``seconds`` of training.

    Args:
        before: card of the weights that the run began with, None for random ones.
        validation: figures on the validation rooms; those that are no numbers are left out.
        device: where they were trained.
        threads: of PyTorch on the CPU.
    """
    return {
        "name": config.settings.name,
        "data": {
            "source": "generated rooms (fewview.synthetic.samples), split train",
            "rooms": min(step * config.rooms, config.pool or step * config.rooms),
            "samples": step * config.rooms * config.views,
            "validation_rooms": config.validation_rooms,
            **({"library": _library(Path(config.library))} if config.library else {}),
        },
        "seed": config.seed,
        "steps": step,
        "hardware": _hardware(device, threads),
        "hours": round(seconds / 3600.0, 3),
        "validation": {k: round(v, 5) for k, v in validation.items() if math.isfinite(v)},
        "config": _portable(dataclasses.asdict(config)),
        "torch": torch.__version__,
        **({"began_with": {k: before[k] for k in HISTORY if k in before}} if before else {}),
    }


def _portable(settings: dict[str, Any]) -> dict[str, Any]:
    """Settings with the names of folders, not where they lay."""
    return {
        key: _portable(value)
        if isinstance(value, dict)
        else Path(value).name
        if key in FOLDERS
        else value
        for key, value in settings.items()
    }


def _library(folder: Path) -> dict[str, Any]:
    """Whose models stood in the rooms, under which licences."""
    library = read_library(folder)
    return {"fingerprint": library.fingerprint, "attribution": list(library.credits())}


def _hardware(device: torch.device, threads: int) -> str:
    if device.type == "cuda":
        return str(torch.cuda.get_device_name(device))
    return f"{platform.machine()} CPU, {threads} threads"
