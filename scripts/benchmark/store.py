"""Answers on disk: one small file each, written whole or not at all, keyed by code and data."""

from __future__ import annotations

import os
import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar, cast

Answered = TypeVar("Answered")


@dataclass(frozen=True)
class Record(Generic[Answered]):
    """What a method said and what it took.

    Attributes:
        answer: None where it broke down.
        seconds: CPU seconds by step; steps that concern one scan carry its name.
        error: the last words of a method that broke down.
    """

    answer: Answered | None
    seconds: dict[str, float]
    error: str | None = None


@dataclass(frozen=True)
class Store:
    """A folder of records.

    Attributes:
        folder: below it one folder per scene and method.
    """

    folder: Path

    def path(self, scene: str, method: str, name: str) -> Path:
        """Where a record is; ``scene`` and ``method`` carry fingerprints of data and code."""
        return self.folder / scene / method / f"{name}.pkl"

    def read(self, path: Path) -> Record[Answered]:
        """A record that exists.

        Only files of this benchmark's own making are read: a pickle can run code.
        """
        return cast(Record[Answered], pickle.loads(path.read_bytes()))

    def write(self, path: Path, record: Record[Answered]) -> None:
        """Keep a record; another process never sees half of it."""
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(f".{os.getpid()}.part")
        part.write_bytes(pickle.dumps(record))
        part.replace(path)
