"""Completion of views with the truth around them, measured and kept on disk room by room."""

from __future__ import annotations

import hashlib
from collections.abc import Hashable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import numpy as np

from benchmark.code import fingerprint
from benchmark.completion_baselines import Typical, typical
from benchmark.completion_measure import measured
from benchmark.completion_networks import Networks
from benchmark.completion_scores import Counts
from benchmark.completion_views import GeneratedRoom, ViewSource
from benchmark.store import Record, Store


@dataclass(frozen=True)
class TypicalTask:
    """What some rooms of the training split look like."""

    store: Store
    rooms: tuple[GeneratedRoom, ...]

    @property
    def path(self) -> Path:
        """Where the record is."""
        code = fingerprint("benchmark.completion_baselines")
        told = " ".join([code, *(room.key for room in self.rooms)])
        key = hashlib.sha256(told.encode()).hexdigest()[:12]
        return self.store.path(f"train-{len(self.rooms)}", f"typical-{key}", "typical")

    @property
    def group(self) -> tuple[Hashable, ...]:
        """Of its own."""
        return ("typical",)

    def run(self) -> Record[Typical]:
        """Make the rooms and look at them."""
        return Record(typical(self.rooms), {})

    def answer(self) -> Typical:
        """What is stored."""
        return cast(Typical, _answer(self.store, self.path))


@dataclass(frozen=True)
class CompletionTask:
    """Some views of one room completed, and compared with the truth."""

    store: Store
    source: ViewSource
    networks: Networks
    typical: TypicalTask
    seed: int

    @property
    def path(self) -> Path:
        """Where the record is."""
        told = f"{fingerprint('benchmark.completion_runs')} {self.typical.path} {self.seed}"
        key = hashlib.sha256(f"{told} {self.networks.key}".encode()).hexdigest()[:12]
        return self.store.path(self.source.key, f"completion-{key}", "counts")

    @property
    def group(self) -> tuple[Hashable, ...]:
        """Rooms are independent; several go to one worker."""
        return ("completion",)

    def run(self) -> Record[Counts]:
        """Complete the views and count."""
        views = self.source.views()
        rng = np.random.default_rng(self.seed)
        return Record(measured(views, self.networks, _typical(self.typical), rng), {})

    def counts(self) -> Counts:
        """What was found.

        Raises:
            SystemExit: it broke down.
        """
        return cast(Counts, _answer(self.store, self.path))


@lru_cache(1)
def _typical(task: TypicalTask) -> Typical:
    return task.answer()


def _answer(store: Store, path: Path) -> Any:
    record: Record[Any] = store.read(path)
    if record.answer is None:
        raise SystemExit(f"{path} holds a failure, remove it to try again: {record.error}")
    return record.answer
