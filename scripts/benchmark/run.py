"""Run methods on pairs and sets of scans: in parallel, resumable, each answer kept at once."""

from __future__ import annotations

import hashlib
import itertools
import multiprocessing
import os
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

from tqdm import tqdm

from benchmark.catalogue import Method, MultiMethod, built
from benchmark.methods.interface import Answer, PairMethod, Placement
from benchmark.scenes import Scene
from benchmark.store import Record, Store

CHUNK = 16
"""Pairs that a worker takes at once, so that it prepares few scans twice."""
KEPT_VIEWS = 64
"""Prepared scans that a worker keeps."""


class Task(Protocol):
    """Work whose answer is kept: it pickles, and ``path`` is there once it was done."""

    @property
    def store(self) -> Store:
        """Where answers are kept."""

    @property
    def path(self) -> Path:
        """Of the record, in the store."""

    @property
    def group(self) -> tuple[Hashable, ...]:
        """Tasks of one group share prepared scans."""

    def run(self) -> Record[Any]:
        """Do it."""


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
        return self.store.path(_folder(self.scene), self.method.key, name)

    @property
    def group(self) -> tuple[Hashable, ...]:
        return self.method.key, self.scene.name

    def run(self) -> Record[Answer]:
        method = _made(self.method)
        turns = self.turns or _turns(method, self.scene, (self.source, self.target))
        views, seconds = [], {}
        for name, turn in zip((self.source, self.target), turns, strict=True):
            view, seconds[name] = _view(method, self.method, self.scene, name, turn)
            views.append(view)
        answer, seconds["match"] = _timed(lambda: method.match(*views))
        return Record(answer, seconds)


@dataclass(frozen=True)
class TurnsTask:
    """The quarter turns of scans that are seen together."""

    store: Store
    method: Method
    scene: Scene
    names: tuple[str, ...]

    @property
    def path(self) -> Path:
        return self.store.path(_folder(self.scene), self.method.key, f"turns-{_digest(self.names)}")

    @property
    def group(self) -> tuple[Hashable, ...]:
        return self.method.key, self.scene.name

    def run(self) -> Record[tuple[int, ...]]:
        method = _made(self.method)
        turns, seconds = _timed(lambda: _turns(method, self.scene, self.names))
        return Record(turns, {"turns": seconds})


@dataclass(frozen=True)
class SetTask:
    """One multi-scan method on a set of scans whose pairs are answered."""

    store: Store
    method: MultiMethod
    scene: Scene
    names: tuple[str, ...]

    @property
    def path(self) -> Path:
        return self.store.path(_folder(self.scene), self.method.key, f"set-{_digest(self.names)}")

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
        return TurnsTask(self.store, built(self.method.pairs), self.scene, self.names)

    def pairs(self) -> dict[tuple[int, int], PairTask]:
        """What is to be known before the set; needs `turns`."""
        turns: Record[tuple[int, ...]] = self.store.read(self.turns.path)
        turned = turns.answer or (0,) * len(self.names)
        return {
            (i, j): PairTask(
                self.store,
                built(self.method.pairs),
                self.scene,
                self.names[i],
                self.names[j],
                (turned[i], turned[j]),
            )
            for i, j in self.indices
        }

    def run(self) -> Record[list[Placement | None]]:
        answers = {
            pair: self.store.read(task.path).answer or Answer()
            for pair, task in self.pairs().items()
        }
        solve = import_module(self.method.backend).solve

        def frame(index: int) -> Any:
            return self.scene.load(self.names[index])

        placements, seconds = _timed(
            lambda: solve(self.names, frame, answers, **self.method.arguments)
        )
        return Record(placements, {"solve": seconds})

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
    run(open_sets, jobs, "sets")


def run(tasks: Iterable[Task], jobs: int, what: str) -> None:
    """Answer what the store does not hold yet.

    A method that breaks down is recorded with its error and counts as having no answer.
    """
    missing = {task.path: task for task in tasks if not task.path.is_file()}
    chunks = [chunk for group in _groups(missing.values()) for chunk in _chunks(group)]
    if not chunks:
        return
    context = multiprocessing.get_context("spawn")
    with (
        _one_thread_each(),
        ProcessPoolExecutor(jobs, mp_context=context, initializer=_end_with_parent) as pool,
        tqdm(total=len(missing), desc=what, smoothing=0.05) as bar,
    ):
        for future in as_completed([pool.submit(_work, chunk) for chunk in chunks]):
            bar.update(future.result())


def _end_with_parent() -> None:
    """Workers of a run that was killed stop at once and leave nothing half-written."""
    parent = multiprocessing.parent_process()
    if parent is not None:

        def watch() -> None:
            parent.join()
            os._exit(1)

        threading.Thread(target=watch, daemon=True).start()


def _groups(tasks: Iterable[Task]) -> list[list[Task]]:
    groups: dict[Hashable, list[Task]] = {}
    for task in tasks:
        groups.setdefault(task.group, []).append(task)
    return list(groups.values())


def _chunks(tasks: list[Task]) -> Iterator[list[Task]]:
    for start in range(0, len(tasks), CHUNK):
        yield tasks[start : start + CHUNK]


def _work(tasks: list[Task]) -> int:
    for task in tasks:
        try:
            record: Record[Any] = task.run()
        except Exception as error:  # noqa: BLE001 - whatever a method throws is its failure
            record = Record(None, {}, f"{type(error).__name__}: {error}")
        task.store.write(task.path, record)
    return len(tasks)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Workers inherit this: every library is held to one thread, times are CPU times."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


class _Kept:
    """The results of the last calls, by key."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.values: OrderedDict[Hashable, Any] = OrderedDict()

    def get(self, key: Hashable, make: Callable[[], Any]) -> Any:
        if key not in self.values:
            self.values[key] = make()
        self.values.move_to_end(key)
        if len(self.values) > self.size:
            self.values.popitem(last=False)
        return self.values[key]


_methods, _glances, _views = _Kept(32), _Kept(4 * KEPT_VIEWS), _Kept(KEPT_VIEWS)


def _made(method: Method) -> PairMethod:
    made: PairMethod = _methods.get(method.key, method.make)
    return made


def _turns(made: PairMethod, scene: Scene, names: Sequence[str]) -> tuple[int, ...]:
    if type(made).glance is PairMethod.glance:
        return (0,) * len(names)
    return made.turns([_glance(made, scene, name) for name in names])


def _glance(made: PairMethod, scene: Scene, name: str) -> Any:
    key = (type(made).glance, scene.folder, name)
    return _glances.get(key, lambda: made.glance(scene.load(name)))


def _view(
    made: PairMethod, method: Method, scene: Scene, name: str, turn: int
) -> tuple[Any, float]:
    """A prepared scan and the CPU seconds it took when it was prepared."""

    def make() -> tuple[Any, float]:
        frame = scene.load(name)
        return _timed(lambda: made.prepare(frame, turn))

    prepared: tuple[Any, float] = _views.get((method.key, scene.folder, name, turn), make)
    return prepared


def _timed(step: Callable[[], Any]) -> tuple[Any, float]:
    start = time.process_time()
    result = step()
    return result, time.process_time() - start


def _folder(scene: Scene) -> str:
    return f"{scene.name}-{scene.fingerprint}"


def _digest(names: Sequence[str]) -> str:
    return hashlib.sha256("\n".join(names).encode()).hexdigest()[:12]
