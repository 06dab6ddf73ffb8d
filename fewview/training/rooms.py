"""Batches of rooms: step k always sees the same rooms, whoever makes them and how often."""

from __future__ import annotations

import dataclasses
import hashlib
import os
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np
from torch.utils.data import DataLoader, Dataset

from fewview import geometry, synthetic
from fewview.errors import FewviewError
from fewview.training.problem import Batch
from fewview.training.settings import TrainConfig

if TYPE_CHECKING:
    from fewview.synthetic import Library, Split
    from fewview.synthetic.samples import RoomSample
    from fewview.training.problem import Room

SPARE_ROOMS = 5
SPARE_STRIDE = 10**8
PREFETCH = 4
RINGS = ("colour", "depth", "normal", "semantics", "observed", "measured", "plane_id")
LEFT = np.array([1.0, -1.0, 1.0])
"""Mirrors the level frame's left axis."""
MIRROR = np.diag([*LEFT, 1.0])
RIGHT = np.array([-1.0, 1.0, 1.0])
"""Mirrors a camera's right axis."""


class RoomSource(Protocol):
    """Where rooms come from."""

    def __call__(self, split: Split, index: int, views: int, size: int) -> Room:
        """Room number ``index`` of a split."""


def generated(
    split: Split, index: int, views: int, size: int, library: Library | None = None
) -> RoomSample:
    """Make a room; one that cannot be made is replaced by another, so that no run ends of it.

    Raises:
        FewviewError: none of the replacements can be made either.
    """
    from fewview.synthetic import split_seed
    from fewview.synthetic.samples import room_sample

    reasons: list[Exception] = []
    while len(reasons) < SPARE_ROOMS:
        seed = split_seed(split, index + len(reasons) * SPARE_STRIDE)
        try:
            return room_sample(seed, views, size, library=library)
        except Exception as error:
            reasons.append(error)
    raise FewviewError(f"room {index} of {split} cannot be made: {reasons[0]!r}") from reasons[0]


def generator_fingerprint(library: Library | None = None) -> str:
    """Of what makes rooms: the generator's code and the library's contents."""
    makes = hashlib.sha256(library.fingerprint.encode() if library else b"")
    for package in (synthetic, geometry):
        for file in sorted(Path(str(package.__file__)).parent.glob("*.py")):
            makes.update(file.read_bytes())
    return makes.hexdigest()[:12]


@dataclasses.dataclass(frozen=True)
class Stored:
    """Rooms of another source kept in a folder, real numbers in half precision."""

    folder: Path
    source: RoomSource

    def __call__(self, split: Split, index: int, views: int, size: int) -> Room:
        """Read the room, or make it and write it."""
        path = self.folder / f"{split}-{views}x{size}" / f"{index:07d}.npz"
        if not path.is_file():
            self._write(path, self.source(split, index, views, size))
        with np.load(path) as arrays:
            values = {name: _widened(arrays[name]) for name in arrays.files}
        return SimpleNamespace(**values)

    @staticmethod
    def _write(path: Path, room: Room) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(f".{os.getpid()}.part")
        with partial.open("wb") as file:
            arrays = {name: _narrowed(array) for name, array in vars(room).items()}
            np.savez(file, allow_pickle=False, **arrays)
        partial.replace(path)


class RoomBatches(Dataset[Batch]):
    """Batch number k of a split; every other time that a room comes round it is mirrored."""

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
        rng = np.random.default_rng([c.seed, step, int(training)])
        rooms = []
        for number in range(step * self.rooms, (step + 1) * self.rooms):
            turn, index = divmod(number, c.pool) if training and c.pool else (0, number)
            index += c.first_room if training else 0
            room = self.source(self.split, index, c.made_views or c.views, c.size)
            room = some_views(room, c.views, rng)
            rooms.append(c.settings.mirrored(room) if turn % 2 else room)
        return c.settings.batch(rooms, rng)


def some_views(room: Room, count: int, rng: np.random.Generator) -> Room:
    """A room with ``count`` of its cameras."""
    chosen = rng.permutation(len(room.level_T_world))[:count]
    return SimpleNamespace(**{name: array[chosen] for name, array in vars(room).items()})


def mirrored(room: RoomSample) -> RoomSample:
    """The same room with left and right exchanged: in the world, every level frame and image."""
    size = room.depth.shape[1]
    columns = (3 * size - 1 - np.arange(4 * size)) % (4 * size)
    values = {name: getattr(room, name)[:, :, columns] for name in RINGS}
    values["normal"] = values["normal"] * LEFT.astype(np.float32)
    values["level_T_world"] = MIRROR @ room.level_T_world @ MIRROR
    values["scan_R_level"] = np.diag(RIGHT) @ room.scan_R_level @ np.diag(LEFT)
    values["layout"] = room.layout[:, :, ::-1].copy()
    values["planes"] = room.planes * np.array([*LEFT, 1.0], np.float32)
    return cast("RoomSample", SimpleNamespace(**{**vars(room), **values}))


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
    """Where a run's rooms come from. With a store they are kept as they are made, and what a
    problem prepares of them beside them, each in a folder of what makes them.

    Raises:
        FewviewError: the library's folder holds no furniture models.
    """
    library = synthetic.read_library(Path(config.library)) if config.library else None
    made: RoomSource = partial(generated, library=library)
    if not config.store:
        return config.settings.prepared(made)
    folder = Path(config.store) / generator_fingerprint(library)
    source = config.settings.prepared(Stored(folder, made))
    preparation = config.settings.preparation()
    return (
        Stored(folder.with_name(f"{folder.name}-{preparation}"), source) if preparation else source
    )


def _narrowed(array: np.ndarray) -> np.ndarray:
    return array.astype(np.float16) if array.dtype == np.float32 else array


def _widened(array: np.ndarray) -> np.ndarray:
    return array.astype(np.float32) if array.dtype == np.float16 else array
