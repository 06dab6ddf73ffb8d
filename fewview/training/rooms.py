"""Batches of rooms: step k always sees the same rooms, whoever makes them and how often."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np
from torch.utils.data import DataLoader, Dataset

from fewview.errors import FewviewError
from fewview.training.problem import Batch
from fewview.training.settings import TrainConfig

if TYPE_CHECKING:
    from fewview.synthetic import Split
    from fewview.synthetic.samples import RoomSample

SPARE_ROOMS = 5
SPARE_STRIDE = 10**8
PREFETCH = 4


class RoomSource(Protocol):
    """Where rooms come from."""

    def __call__(self, split: Split, index: int, views: int, size: int) -> RoomSample:
        """Room number ``index`` of a split."""


def generated(split: Split, index: int, views: int, size: int) -> RoomSample:
    """Make a room; one without a place to stand is replaced by another.

    Raises:
        FewviewError: none of the replacements is usable either.
    """
    from fewview.synthetic import split_seed
    from fewview.synthetic.samples import room_sample

    for attempt in range(SPARE_ROOMS):
        try:
            return room_sample(split_seed(split, index + attempt * SPARE_STRIDE), views, size)
        except FewviewError as error:
            reason = error
    raise FewviewError(f"room {index} of {split}: {reason}")


@dataclasses.dataclass(frozen=True)
class Stored:
    """Rooms of another source kept in a folder, real numbers in half precision."""

    folder: Path
    source: RoomSource = generated

    def __call__(self, split: Split, index: int, views: int, size: int) -> RoomSample:
        """Read the room, or make it and write it."""
        path = self.folder / f"{split}-{views}x{size}" / f"{index:07d}.npz"
        if not path.is_file():
            self._write(path, self.source(split, index, views, size))
        with np.load(path) as arrays:
            values = {name: _widened(arrays[name]) for name in arrays.files}
        return cast("RoomSample", SimpleNamespace(**values))

    @staticmethod
    def _write(path: Path, room: RoomSample) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(f".{os.getpid()}.part")
        with partial.open("wb") as file:
            arrays = {name: _narrowed(array) for name, array in vars(room).items()}
            np.savez(file, allow_pickle=False, **arrays)
        partial.replace(path)


class RoomBatches(Dataset[Batch]):
    """Batch number k of a split."""

    def __init__(
        self,
        config: TrainConfig,
        source: RoomSource,
        split: Split = "train",
        rooms: int | None = None,
    ) -> None:
        self.config, self.source, self.split = config, source, split
        self.rooms = config.rooms if rooms is None else rooms

    def __getitem__(self, step: int) -> Batch:
        c, training = self.config, self.split == "train"
        numbers = range(step * self.rooms, (step + 1) * self.rooms)
        round_of = c.pool if training and c.pool else len(numbers) + numbers[0]
        rooms = [self.source(self.split, i % round_of, c.views, c.size) for i in numbers]
        rng = np.random.default_rng([c.seed, step, int(training)])
        return c.settings.batch(rooms, rng)


def loader(batches: RoomBatches, steps: range, jobs: int) -> DataLoader[Batch]:
    """The batches of ``steps`` in order, made by ``jobs`` processes beside this one (or in it)."""
    return DataLoader(
        batches,
        batch_size=None,
        sampler=steps,
        num_workers=jobs,
        prefetch_factor=PREFETCH if jobs else None,
    )


def source_of(config: TrainConfig) -> RoomSource:
    """Where a run's rooms come from."""
    return Stored(Path(config.store)) if config.store else generated


def _narrowed(array: np.ndarray) -> np.ndarray:
    return array.astype(np.float16) if array.dtype == np.float32 else array


def _widened(array: np.ndarray) -> np.ndarray:
    return array.astype(np.float32) if array.dtype == np.float16 else array
