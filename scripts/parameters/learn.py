"""Learning positive scales by gradient descent on their logarithms (Adam, as in the paper)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

Problem = TypeVar("Problem")
Values = Mapping[str, Tensor]
Loss = Callable[[Problem, Values], Tensor]

LOGGED = 20
"""Steps between lines of progress."""
FARTHEST = 4.0
"""Values stay within this factor of where they began; one that ends there has no minimum near."""


@dataclass(frozen=True)
class Descent:
    """How long and how fast: problems of a step are drawn with the seed, the rate falls to 0."""

    steps: int
    batch: int
    rate: float
    seed: int


def learned(
    loss: Loss[Problem], problems: Sequence[Problem], start: Values, descent: Descent
) -> dict[str, Tensor]:
    """Values that make the mean loss of the problems small."""
    rng = np.random.default_rng(descent.seed)
    change = {name: torch.zeros_like(value).requires_grad_() for name, value in start.items()}
    optimiser = torch.optim.Adam(change.values(), lr=descent.rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, descent.steps)
    order = np.zeros(0, dtype=np.int64)
    for step in range(descent.steps):
        while len(order) < descent.batch:
            order = np.append(order, rng.permutation(len(problems)))
        chosen, order = order[: descent.batch], order[descent.batch :]
        optimiser.zero_grad()
        for i in chosen:
            part = loss(problems[i], _changed(start, change)) / descent.batch
            part.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
        if (step + 1) % LOGGED == 0:
            print(f"step {step + 1}/{descent.steps}", flush=True)
        with torch.no_grad():
            for log in change.values():
                log.clamp_(-math.log(FARTHEST), math.log(FARTHEST))
    return {name: value.detach() for name, value in _changed(start, change).items()}


def mean_loss(loss: Loss[Problem], problems: Sequence[Problem], values: Values) -> float:
    """Mean over the problems, NaN without any."""
    found = [loss(problem, values).item() for problem in problems]
    return float(np.mean(found)) if found else math.nan


def at_the_bound(start: Values, values: Values) -> list[str]:
    """Names of values that went as far from their start as they may."""
    far = 0.99 * math.log(FARTHEST)
    return [name for name in start if bool(((values[name] / start[name]).log().abs() > far).any())]


def _changed(start: Values, change: Values) -> dict[str, Tensor]:
    return {name: value * change[name].exp() for name, value in start.items()}
