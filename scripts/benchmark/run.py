"""Do work in parallel, resumably: each answer is kept the moment it is known."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Hashable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

from tqdm import tqdm

from benchmark.store import Record, Store

CHUNK = 16
"""Tasks that a worker takes at once, so that it prepares few scans twice."""


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
