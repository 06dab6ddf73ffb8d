"""What is asked of methods: a pair, the upright turns of scans seen together, a set of scans."""

from __future__ import annotations

import hashlib
import itertools
import time
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

from benchmark.catalogue import PAIR_METHODS, Method, MultiMethod
from benchmark.methods.interface import Answer, PairMethod, Placement
from benchmark.run import run
from benchmark.scenes import Scene
from benchmark.store import Record, Store
from fewview.types import Array

KEPT_METHODS, KEPT_GLANCES, KEPT_VIEWS = 32, 256, 64
"""Methods, glances and prepared scans that a worker keeps."""


@dataclass(frozen=True)
class PairTask:
    """One method on two scans of a scene.

    Attributes:
        turns: quarter turns of source and target as decided for a set of scans; decided from the
            two alone when not given.
    """

    store: Store
    method: Method
    scene: Scene
    source: str
    target: str
    turns: tuple[int, int] | None = None

    @property
    def path(self) -> Path:
        turned = "" if self.turns is None else f"~{self.turns[0]}{self.turns[1]}"
        name = f"{self.source}~{self.target}{turned}"
        return self.store.path(self.scene.key, self.method.key, name)

    @property
    def group(self) -> tuple[Hashable, ...]:
        return self.method.key, self.scene.name

    def run(self) -> Record[Answer]:
        method = _made(self.method)
        turns = self.turns or _turns(self.method, self.scene, (self.source, self.target))
        views, seconds = [], {}
        for name, turn in zip((self.source, self.target), turns, strict=True):
            view, seconds[name] = _view(self.method, self.scene, name, turn)
            views.append(view)
        answer, seconds["match"] = _timed(lambda: method.match(*views))
        return Record(answer, seconds)

    def answer(self) -> Answer:
        """What is stored; without candidates where the method broke down."""
        record: Record[Answer] = self.store.read(self.path)
        return record.answer or Answer()


@dataclass(frozen=True)
class TurnsTask:
    """The quarter turns of scans that are seen together."""

    store: Store
    method: Method
    scene: Scene
    names: tuple[str, ...]

    @property
    def path(self) -> Path:
        return self.store.path(self.scene.key, self.method.key, f"turns-{_digest(self.names)}")

    @property
    def group(self) -> tuple[Hashable, ...]:
        return self.method.key, self.scene.name

    def run(self) -> Record[tuple[int, ...]]:
        _made(self.method)  # its imports are not part of the time
        turns, seconds = _timed(lambda: _turns(self.method, self.scene, self.names))
        return Record(turns, {"turns": seconds})


@dataclass(frozen=True)
class ViewTask:
    """A scan as a method prepares it, for multi-scan methods that look at scans again.

    Its time is part of that of the pairs.
    """

    store: Store
    method: Method
    scene: Scene
    name: str
    turn: int

    @property
    def path(self) -> Path:
        return self.store.path(self.scene.key, self.method.key, f"view-{self.name}~{self.turn}")

    @property
    def group(self) -> tuple[Hashable, ...]:
        return self.method.key, self.scene.name

    def run(self) -> Record[Any]:
        view, seconds = _view(self.method, self.scene, self.name, self.turn)
        return Record(view, {"view": seconds})


@dataclass(frozen=True)
class SetTask:
    """One multi-scan method on a set of scans whose pairs are answered."""

    store: Store
    method: MultiMethod
    scene: Scene
    names: tuple[str, ...]

    @property
    def path(self) -> Path:
        return self.store.path(self.scene.key, self.method.key, f"set-{_digest(self.names)}")

    @property
    def group(self) -> tuple[Hashable, ...]:
        return self.method.key, self.scene.name, self.names

    @property
    def indices(self) -> Iterator[tuple[int, int]]:
        """The pairs that the method looks at."""
        everything = range(len(self.names))
        if self.method.consecutive:
            return itertools.pairwise(everything)
        return itertools.combinations(everything, 2)

    @property
    def turns(self) -> TurnsTask:
        """What is to be known before the pairs."""
        return TurnsTask(self.store, PAIR_METHODS[self.method.pairs], self.scene, self.names)

    def pairs(self) -> dict[tuple[int, int], PairTask]:
        """What is to be known before the set; needs `turns`."""
        turned = self._turned()
        return {
            (i, j): PairTask(
                self.store,
                PAIR_METHODS[self.method.pairs],
                self.scene,
                self.names[i],
                self.names[j],
                (turned[i], turned[j]),
            )
            for i, j in self.indices
        }

    def _turned(self) -> tuple[int, ...]:
        turns: Record[tuple[int, ...]] = self.store.read(self.turns.path)
        return turns.answer or (0,) * len(self.names)

    def views(self) -> list[ViewTask]:
        """The prepared scans, where the method looks at them again; needs `turns`."""
        if not self.method.views:
            return []
        method = PAIR_METHODS[self.method.pairs]
        turned = zip(self.names, self._turned(), strict=True)
        return [ViewTask(self.store, method, self.scene, name, turn) for name, turn in turned]

    def run(self) -> Record[list[Placement | None]]:
        answers = {pair: task.answer() for pair, task in self.pairs().items()}
        views = [self.store.read(task.path).answer for task in self.views()]
        solve = import_module(self.method.backend).solve

        def frame(index: int) -> Any:
            return self.scene.load(self.names[index])

        seen = {"views": views} if self.method.views else {}
        placements, seconds = _timed(
            lambda: solve(self.names, frame, answers, **seen, **self.method.arguments)
        )
        return Record(placements, {"solve": seconds})

    def largest(self) -> list[Array | None]:
        """World_T_scan of the stored answer's largest component, None for scans outside it."""
        record: Record[list[Placement | None]] = self.store.read(self.path)
        placements = record.answer or [None] * len(self.names)
        return [p.world_T_scan if p is not None and p.component == 0 else None for p in placements]

    def seconds(self) -> float:
        """CPU seconds of everything: scans once each, pairs, back-end."""
        own: dict[str, list[float]] = {}
        total = self.store.read(self.path).seconds["solve"]
        total += self.store.read(self.turns.path).seconds["turns"]
        for task in self.pairs().values():
            taken = dict(self.store.read(task.path).seconds)
            total += taken.pop("match", 0.0)
            for name, seconds in taken.items():
                own.setdefault(name, []).append(seconds)
        return total + sum(sum(values) / len(values) for values in own.values())


def run_sets(tasks: Sequence[SetTask], jobs: int) -> None:
    """Make sure that every set is answered, and before it its turns and its pairs."""
    open_sets = [task for task in tasks if not task.path.is_file()]
    run([task.turns for task in open_sets], jobs, "orientation")
    run([pair for task in open_sets for pair in task.pairs().values()], jobs, "pairs")
    run([view for task in open_sets for view in task.views()], jobs, "scans")
    run(open_sets, jobs, "sets")


@lru_cache(KEPT_METHODS)
def _made(method: Method) -> PairMethod:
    return method.make()


def _turns(method: Method, scene: Scene, names: Sequence[str]) -> tuple[int, ...]:
    made = _made(method)
    if type(made).glance is PairMethod.glance:
        return (0,) * len(names)
    return made.turns([_glance(method, scene, name) for name in names])


@lru_cache(KEPT_GLANCES)
def _glance(method: Method, scene: Scene, name: str) -> Any:
    return _made(method).glance(scene.load(name))


@lru_cache(KEPT_VIEWS)
def _view(method: Method, scene: Scene, name: str, turn: int) -> tuple[Any, float]:
    """A prepared scan and the CPU seconds it took when it was prepared."""
    made, frame = _made(method), scene.load(name)
    return _timed(lambda: made.prepare(frame, turn))


def _timed(step: Callable[[], Any]) -> tuple[Any, float]:
    start = time.process_time()
    result = step()
    return result, time.process_time() - start


def _digest(names: Sequence[str]) -> str:
    return hashlib.sha256("\n".join(names).encode()).hexdigest()[:12]
