"""How long the completion of one scan takes."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch

from benchmark.code import fingerprint
from benchmark.completion_networks import Networks
from benchmark.store import Record, Store
from fewview.completion.layout.points import ScanPoints, scan_points
from fewview.completion.panorama.walls import scan_ring
from fewview.config import FeatureConfig
from fewview.synthetic import generate, split_seed
from fewview.types import RingScan

THREADS, REPEATS = (1, 2), 5
TOGETHER = "all together"
CPU = "CPU, 1 thread"
Milliseconds = dict[str, dict[str, float]]
"""By step and column: what passes with so many threads, and `CPU` time, which holds on a machine
that is busy otherwise."""


@dataclass(frozen=True)
class SpeedTask:
    """Times of a frame of 640 x 480 pixels, the best of `REPEATS`."""

    store: Store
    networks: Networks

    @property
    def path(self) -> Path:
        """Where the record is."""
        key = f"{fingerprint('benchmark.completion_speed')}-{self.networks.key}"
        return self.store.path("speed", f"completion-{key}", "ms")

    @property
    def group(self) -> tuple[Hashable, ...]:
        """Of its own."""
        return ("speed",)

    def run(self) -> Record[Milliseconds]:
        """Measure every step with every number of threads."""
        steps = _steps(self.networks)
        before, found = torch.get_num_threads(), {name: dict[str, float]() for name in steps}
        for threads in THREADS:
            torch.set_num_threads(threads)
            for name, step in steps.items():
                wall, cpu = _best_ms(step)
                found[name] |= {CPU: cpu} if threads == 1 else {}
                found[name][f"{threads} thread{'s' * (threads > 1)}"] = wall
        torch.set_num_threads(before)
        return Record(found, {})

    def milliseconds(self) -> Milliseconds:
        """What was found; nothing where it broke down."""
        record: Record[Milliseconds] = self.store.read(self.path)
        return record.answer or {}


def _steps(networks: Networks) -> dict[str, Callable[[], object]]:
    from fewview.completion import complete

    frame = generate(split_seed("test", 0), 1).frames[0]
    up = complete("scan", frame, 0, FeatureConfig(kinds=()), 0).levelling.level_R_scan[2]

    def shown() -> tuple[RingScan, ScanPoints]:
        ring = scan_ring(frame.depth, frame.colour, frame.intrinsics, up)
        return ring, scan_points(ring, np.random.default_rng(0))

    given = shown()
    alone = {folder[0]: Networks((folder,)) for folder in networks.folders}
    return {
        "ring and points": shown,
        **{name: partial(one.complete, *given) for name, one in alone.items()},
        TOGETHER: lambda: networks.complete(*shown()),
    }


def _best_ms(step: Callable[[], object]) -> tuple[float, float]:
    """Milliseconds that pass, and of CPU, each the least of all runs but the first."""
    step()
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter(), time.process_time()
        step()
        times.append((time.perf_counter() - start[0], time.process_time() - start[1]))
    wall, cpu = zip(*times, strict=True)
    return 1000.0 * min(wall), 1000.0 * min(cpu)
