"""Training rooms as the aligner and the verifier see them: every view completed, from above."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import numpy as np

from fewview import weights
from fewview.alignment import Drawing, draw, drawing, planar_motion
from fewview.completion import layout as layout_completion
from fewview.completion.layout.complete import NAME, completed_layouts
from fewview.completion.layout.network import LayoutNetwork, LayoutNetworkConfig
from fewview.completion.layout.points import POINTS
from fewview.completion.panorama.ring import ring_points
from fewview.geometry import se3
from fewview.synthetic import split_seed
from fewview.training.point_batches import room_points
from fewview.training.problem import Problem
from fewview.training.rooms import MIRROR
from fewview.types import Array, FloatArray, IntArray, RingScan

if TYPE_CHECKING:
    from fewview.synthetic import Split
    from fewview.synthetic.samples import RoomSample
    from fewview.training.rooms import RoomSource

VOXEL_M = 0.2
APART = 0.1


@dataclass(frozen=True, eq=False)
class DrawnRoom:
    """V views of one room.

    Attributes:
        channels: (V, CHANNELS, CELLS, CELLS) float32 of their `Drawing`s.
        grid_T_level: (V, 4, 4) from the views' level frames into the grids'.
        floor_z: (V,) in the grids.
        level_T_world: (V, 4, 4).
        shared: (V, N) share 0..1 of the smaller view's surface that it and each of the N views
            that were drawn have both measured.
        number: (V,) of the views among the N.
    """

    channels: FloatArray
    grid_T_level: Array
    floor_z: Array
    level_T_world: Array
    shared: Array
    number: IntArray


class DrawnRooms:
    """The views of some rooms one after the other, B in all."""

    def __init__(self, rooms: Sequence[DrawnRoom]) -> None:
        self.room = np.repeat(np.arange(len(rooms)), [len(room.channels) for room in rooms])
        self.drawings = [
            Drawing(*view)
            for room in rooms
            for view in zip(room.channels, room.grid_T_level, room.floor_z.tolist(), strict=True)
        ]
        self.level_T_world = np.concatenate([room.level_T_world for room in rooms])
        self._shared = [row for room in rooms for row in room.shared[:, room.number]]
        self._first = np.searchsorted(self.room, self.room)

    def pairs(self) -> list[IntArray]:
        """For each room, all ordered pairs (P, 2) of its views."""
        views = np.split(np.arange(len(self.room)), np.unique(self._first)[1:])
        return [np.array(list(itertools.permutations(v, 2)), np.int64) for v in views]

    def apart(self, a: int, b: int) -> bool:
        """Whether two views of one room share less than a tenth of their surface."""
        return bool(self._shared[a][b - self._first[b]] < APART)

    def motion(self, a: int, b: int) -> FloatArray:
        """(1, 3) true yaw and shift from the grid of view ``a`` to that of view ``b``."""
        pose = self.target_T_source(a, b)[None]
        return planar_motion(self.drawings[a], self.drawings[b], pose)

    def target_T_source(self, a: int, b: int) -> Array:
        """(4, 4) from the level frame of view ``a`` to that of view ``b``."""
        return np.asarray(self.level_T_world[b] @ se3.inverse(self.level_T_world[a]))


@dataclass(frozen=True)
class DrawnProblem(Problem):
    """A problem that learns from drawn rooms."""

    weights: str = ""
    """Folder of the weights that it builds on, the layout network's first of all; empty for the
    shipped ones."""
    tilt_deg: float = 1.0
    """Standard deviation of the error of the level frame about each horizontal axis."""

    @property
    def folder(self) -> Path:
        """Where those weights are."""
        return weights.folder_of(self.weights)

    def prepared(self, rooms: RoomSource) -> RoomSource:
        return Draughtsman(rooms, self.folder, self.tilt_deg)

    def preparation(self) -> str:
        return drawing_fingerprint(self.folder, self.tilt_deg)

    def mirrored(self, room: DrawnRoom) -> DrawnRoom:
        return mirrored(room)


@dataclass(frozen=True)
class Draughtsman:
    """A source of drawn rooms.

    Attributes:
        rooms: what is drawn.
        folder: of the layout network's weights.
        tilt_deg: standard deviation of the error of the level frame about each horizontal axis.
    """

    rooms: RoomSource
    folder: Path
    tilt_deg: float

    def __call__(self, split: Split, index: int, views: int, size: int) -> DrawnRoom:
        """Draw room number ``index`` of a split.

        Raises:
            FewviewError: the weights are missing or damaged.
        """
        room: RoomSample = self.rooms(split, index, views, size)
        rng = np.random.default_rng([split_seed(split, index), 2])
        return drawn(room, self.folder, self.tilt_deg, rng)


def drawn(room: RoomSample, folder: Path, tilt_deg: float, rng: np.random.Generator) -> DrawnRoom:
    """Complete and draw every view of a room; ``rng`` chooses points and tilts."""
    scans = room_points([room], POINTS, tilt_deg, rng)
    network = _layout_network(folder)
    grid_T_level = se3.pose(scans.tilts @ scans.turns, np.zeros((len(scans.turns), 3)))
    layouts = completed_layouts(network, scans.batch, list(grid_T_level))
    drawings, seen = [], []
    views = zip(room.colour, room.measured, layouts, room.level_T_world, strict=True)
    for colour, depth, layout, level_T_world in views:
        drawings.append(draw(RingScan(colour, depth, np.eye(4)), layout))
        points = ring_points(depth)[depth > 0].astype(np.float64)
        seen.append(_voxels(se3.transform(se3.inverse(level_T_world), points)))
    return DrawnRoom(
        channels=np.stack([drawing.channels for drawing in drawings]),
        grid_T_level=grid_T_level,
        floor_z=np.array([drawing.floor_z for drawing in drawings]),
        level_T_world=room.level_T_world,
        shared=np.array([[_shared(a, b) for b in seen] for a in seen]),
        number=np.arange(len(drawings)),
    )


def mirrored(room: DrawnRoom) -> DrawnRoom:
    """The same room with left and right exchanged."""
    values = {
        "channels": room.channels[..., ::-1].copy(),
        "grid_T_level": MIRROR @ room.grid_T_level @ MIRROR,
        "level_T_world": MIRROR @ room.level_T_world @ MIRROR,
    }
    return cast(DrawnRoom, SimpleNamespace(**{**vars(room), **values}))


def drawing_fingerprint(folder: Path, tilt_deg: float) -> str:
    """Of what makes drawings of rooms: the layout network's weights, the tilt and the code."""
    makes = hashlib.sha256(str(tilt_deg).encode())
    makes.update((folder / f"{NAME}.safetensors").read_bytes())
    completes = sorted(Path(str(layout_completion.__file__)).parent.glob("*.py"))
    for file in (*completes, Path(drawing.__file__)):
        makes.update(file.read_bytes())
    return makes.hexdigest()[:12]


@cache
def _layout_network(folder: Path) -> LayoutNetwork:
    return weights.shipped(NAME, lambda size: LayoutNetwork(LayoutNetworkConfig(**size)), folder)


def _voxels(points: Array) -> frozenset[int]:
    """The cells of a grid in the world that hold points (n, 3)."""
    index = np.floor(points / VOXEL_M).astype(np.int64) + 512
    return frozenset((index @ [1 << 20, 1 << 10, 1]).tolist())


def _shared(a: frozenset[int], b: frozenset[int]) -> float:
    return len(a & b) / max(1, min(len(a), len(b)))
