"""A furnished room: its surfaces as one ray-castable, textured, z-up world with the floor at 0."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fewview.synthetic.atlas import Atlas, Tones, pack, small
from fewview.synthetic.classes import Surface
from fewview.synthetic.decoration import decorate
from fewview.synthetic.exchange import exchange_for
from fewview.synthetic.furnish import Standing, furnish
from fewview.synthetic.items import Patches
from fewview.synthetic.library import Library
from fewview.synthetic.plan import Plan, make_plan
from fewview.synthetic.rays import TRIANGLES, Embree
from fewview.synthetic.shell import Structure, shell
from fewview.synthetic.surfaces import labelled, lathed
from fewview.synthetic.textures import Image, Rng, Texture, plain
from fewview.types import Array, ColouredMesh, FloatArray, IntArray

if TYPE_CHECKING:
    import open3d as o3d

_COARSER = 4.0


@dataclass(frozen=True, eq=False)
class Room:
    """A room of quadrilaterals with their textures.

    Attributes:
        plan: the shell.
        standing: the furniture on the floor.
        lamps: (k, 3) lights under the ceiling.
        ambient: light that comes from everywhere.
        corners: (n, 4, 3) of all quadrilaterals, metres.
        uv: (n, 4, 2) float32 texture pixels at the corners.
        texture: (n,) index of each quadrilateral's texture.
        texel_m: (n,) float32 metres a texture pixel covers on the quadrilateral.
        surface: (n,) uint8 `Surface` of each quadrilateral.
        plane: (n,) number of the structural plane that each is part of, or -1.
        structure: these planes.
        textures: what is printed on them.
    """

    plan: Plan
    standing: tuple[Standing, ...]
    lamps: Array
    ambient: float
    corners: Array
    uv: FloatArray
    texture: IntArray
    texel_m: FloatArray
    surface: NDArray[np.uint8]
    plane: IntArray
    structure: Structure
    textures: tuple[Texture, ...]

    @cached_property
    def atlas(self) -> Atlas:
        """The textures at full detail."""
        return pack(self.textures)

    @cached_property
    def coarse_atlas(self) -> Atlas | Tones:
        """The textures for small images, quick to paint."""
        return small(self.textures, _COARSER)

    @cached_property
    def normals(self) -> FloatArray:
        """(2 n, 3) float32 unit normals of the triangles, from their front."""
        corners = self.corners[:, TRIANGLES].reshape(-1, 3, 3)
        out = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(out, axis=-1, keepdims=True)
        return np.asarray(out / np.maximum(length, 1e-12), np.float32)

    @cached_property
    def caster(self) -> Embree:
        """Follows rays among the quadrilaterals."""
        return Embree(self.corners)

    @property
    def scene(self) -> o3d.t.geometry.RaycastingScene:
        """Two triangles per quadrilateral, number 2 q and 2 q + 1, single-threaded."""
        return self.caster.scene

    def mesh(self, spacing_m: float = 0.05) -> ColouredMesh:
        """The surfaces as a mesh with a vertex at least every ``spacing_m``, for ground truth."""
        edges = np.linalg.norm(np.roll(self.corners, -1, axis=1) - self.corners, axis=-1)
        columns = np.ceil(edges[:, [0, 2]].max(axis=1) / spacing_m).astype(int).clip(1)
        rows = np.ceil(edges[:, [1, 3]].max(axis=1) / spacing_m).astype(int).clip(1)
        vertices, faces, colours, first = [], [], [], 0
        for shape in sorted(set(zip(rows.tolist(), columns.tolist(), strict=True))):
            quads = np.flatnonzero((rows == shape[0]) & (columns == shape[1]))
            weights, grid = _grid(*shape)
            vertices.append((weights @ self.corners[quads]).reshape(-1, 3))
            starts = first + len(weights) * np.arange(len(quads))
            faces.append((starts[:, None, None] + grid).reshape(-1, 3))
            colours.append(self._colours(quads, weights, spacing_m))
            first += len(vertices[-1])
        return ColouredMesh(
            np.concatenate(vertices), np.concatenate(faces), np.concatenate(colours)
        )

    def _colours(self, quads: IntArray, weights: Array, spacing_m: float) -> Image:
        uv = (weights @ self.uv[quads]).reshape(-1, 2).astype(np.float32)
        number = np.repeat(quads, len(weights))
        footprint = np.float32(0.5 * spacing_m) / self.texel_m[number]
        return self.atlas.lookup(self.texture[number], uv, footprint)


def _grid(rows: int, columns: int) -> tuple[Array, IntArray]:
    """Bilinear weights (n, 4) of a grid on a quadrilateral, and its triangles (m, 3)."""
    v, u = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    weights = np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v], axis=-1)
    number = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    cell = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1)
    return weights.reshape(-1, 4), cell.reshape(-1, 4)[:, TRIANGLES].reshape(-1, 3)


def make_room(seed: int, library: Library | None = None) -> Room:
    """The room of a seed: another plan, furniture and decoration for each.

    Args:
        seed: see `fewview.synthetic.split_seed`.
        library: its models of the seed's split stand in for many of the procedural pieces.
    """
    rng = np.random.default_rng(seed)
    outline, structure = make_plan(rng), Structure()
    walls = shell(outline, rng, structure)
    exchange = exchange_for(seed, library) if library else None
    furnished = [furnish(part, rng, exchange) for part in outline.rooms]
    things = [p for f in furnished for p in (*f.patches, *decorate(f))]
    standing = tuple(piece for f in furnished for piece in f.standing)
    lamps, fixtures = _lights(outline, rng)
    ambient = rng.uniform(0.4, 0.75)
    surfaces = (*walls, *things, *fixtures)
    return _assembled(outline, structure, standing, lamps, ambient, surfaces)


def _lights(outline: Plan, rng: Rng) -> tuple[Array, Patches]:
    """A lamp under the ceiling of each larger part of each room."""
    glass, radius = plain(rng, np.full(3, 250.0)), rng.uniform(0.15, 0.3)
    lamps, fixtures = [], []
    for room in outline.rooms:
        for part in room.parts:
            if np.linalg.norm(part[2] - part[0]) < 2.2 and part is not room.parts[0]:
                continue
            spot = part.mean(axis=0) + rng.normal(0, 0.2, 2)
            high = float(room.height_at(spot[None])[0])
            fixtures.append(lathed([(radius, -0.09), (radius, 0)], (*spot, high), glass))
            lamps.append([*spot, high - 0.25])
    return np.array(lamps), labelled(fixtures, Surface.OTHER)


def _assembled(
    outline: Plan,
    structure: Structure,
    standing: tuple[Standing, ...],
    lamps: Array,
    ambient: float,
    all_: Patches,
) -> Room:
    textures = list({id(p.texture): p.texture for p in all_}.values())
    number = {id(t): i for i, t in enumerate(textures)}
    counts = [len(p.corners) for p in all_]
    corners = np.concatenate([p.corners for p in all_])
    uv = np.concatenate([p.uv for p in all_])
    return Room(
        plan=outline,
        standing=standing,
        lamps=lamps,
        ambient=ambient,
        corners=corners,
        uv=uv.astype(np.float32),
        texture=np.repeat([number[id(p.texture)] for p in all_], counts),
        texel_m=_texel(corners, uv),
        surface=np.repeat(np.array([p.surface for p in all_], np.uint8), counts),
        plane=np.repeat([p.plane for p in all_], counts),
        structure=structure,
        textures=tuple(textures),
    )


def _texel(corners: Array, uv: Array) -> FloatArray:
    """Metres per texture pixel of each quadrilateral, the geometric mean of its two directions."""
    a, b = uv[:, 2] - uv[:, 0], uv[:, 3] - uv[:, 1]
    pixels = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    metres = np.linalg.norm(
        np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]), axis=-1
    )
    return np.asarray(np.sqrt(metres / np.maximum(pixels, 1e-6)), np.float32)
