"""Training rooms as the relation network sees them: points of every view, seen and predicted."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from fewview import weights
from fewview.completion import panorama as completion
from fewview.completion.panorama.complete import NAME
from fewview.completion.panorama.network import PanoramaNetwork, PanoramaNetworkConfig
from fewview.refinement import relation_points
from fewview.refinement.relation_points import OUTSIDE
from fewview.synthetic import split_seed
from fewview.training import panorama, relation_views
from fewview.training.panorama import along_walls
from fewview.training.relation_views import view_points
from fewview.training.rooms import LEFT, MIRROR
from fewview.types import Array, BoolArray, FloatArray

if TYPE_CHECKING:
    from fewview.synthetic import Split
    from fewview.synthetic.samples import RoomSample
    from fewview.training.rooms import RoomSource


@dataclass(frozen=True, eq=False)
class RelationRoom:
    """V views of one room, each with P points in its level frame along the walls that it shows.

    Attributes:
        points, normals: (V, P, 3) float32 as measured or predicted.
        colours: (V, P, 3) uint8, 0 where predicted.
        confidence: (V, P) float32, 1 where seen.
        predicted: (V, P) bool; valid: (V, P) bool, False in rows that only fill up.
        pixels: (V, P) int32 flat pixel of the ring that shows each point, or `OUTSIDE`.
        true_points, true_normals: (V, P, 3) float32 of the surface that is truly in the direction
            of each point, the normal 0 where there is none.
        semantics: (V, P) uint8 class of that surface.
        ring_colour: (V, S, 4 S, 3) uint8, ring_depth: (V, S, 4 S) float32: what was measured.
        level_T_world: (V, 4, 4).
    """

    points: FloatArray
    normals: FloatArray
    colours: NDArray[np.uint8]
    confidence: FloatArray
    predicted: BoolArray
    valid: BoolArray
    pixels: NDArray[np.int32]
    true_points: FloatArray
    true_normals: FloatArray
    semantics: NDArray[np.uint8]
    ring_colour: NDArray[np.uint8]
    ring_depth: FloatArray
    level_T_world: Array


@dataclass(frozen=True)
class Sampler:
    """A source of rooms with their points.

    Attributes:
        rooms: whose points are taken.
        folder: of the 360-image network's weights.
    """

    rooms: RoomSource
    folder: Path

    def __call__(self, split: Split, index: int, views: int, size: int) -> RelationRoom:
        """Complete and sample room number ``index`` of a split.

        Raises:
            FewviewError: the weights are missing or damaged.
        """
        room: RoomSample = self.rooms(split, index, views, size)
        rng = np.random.default_rng([split_seed(split, index), 3])
        return sampled(room, panorama_network(self.folder), rng)


def sampled(room: RoomSample, network: PanoramaNetwork, rng: np.random.Generator) -> RelationRoom:
    """Complete every view of a room and draw its points, evenly over seen and predicted surface."""
    turned = along_walls(room)
    views = [view_points(room, turned, view, network, rng) for view in range(len(room.depth))]
    stacked = {name: np.stack([view[name] for view in views]) for name in views[0]}
    return RelationRoom(**stacked, level_T_world=turned.level_T_world)


def mirrored(room: RelationRoom) -> RelationRoom:
    """The same room with left and right exchanged."""
    size = room.ring_depth.shape[1]
    row, column = np.divmod(room.pixels, 4 * size)
    column = (3 * size - 1 - column) % (4 * size)
    columns = (3 * size - 1 - np.arange(4 * size)) % (4 * size)
    vectors = ("points", "normals", "true_points", "true_normals")
    values = {
        **{name: getattr(room, name) * LEFT.astype(np.float32) for name in vectors},
        **{name: getattr(room, name)[:, :, columns] for name in ("ring_colour", "ring_depth")},
        "pixels": np.where(room.pixels == OUTSIDE, OUTSIDE, row * (4 * size) + column),
        "level_T_world": MIRROR @ room.level_T_world @ MIRROR,
    }
    return cast(RelationRoom, SimpleNamespace(**{**vars(room), **values}))


def sampling_fingerprint(folder: Path) -> str:
    """Of what makes points of rooms: the 360-image network's weights and the code."""
    makes = hashlib.sha256((folder / f"{NAME}.safetensors").read_bytes())
    completes = sorted(Path(str(completion.__file__)).parent.glob("*.py"))
    own = (relation_points.__file__, panorama.__file__, relation_views.__file__, __file__)
    for file in (*completes, *map(Path, own)):
        makes.update(file.read_bytes())
    return makes.hexdigest()[:12]


@cache
def panorama_network(folder: Path) -> PanoramaNetwork:
    """The 360-image network of a folder of weights.

    Raises:
        FewviewError: they are missing or damaged.
    """
    return weights.shipped(
        NAME, lambda size: PanoramaNetwork(PanoramaNetworkConfig(**size)), folder
    )
