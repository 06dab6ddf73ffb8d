"""Textured quadrilaterals, the only kind of surface in a synthetic room."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fewview.synthetic.classes import Surface
from fewview.synthetic.kinds import Kind
from fewview.synthetic.textures import Rng, Texture
from fewview.types import Array

_UNIT = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float64)
_BOX_FACES = np.array(
    [
        [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]],
        [[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1]],
        [[1, 1, 0], [0, 1, 0], [0, 1, 1], [1, 1, 1]],
        [[0, 1, 0], [0, 0, 0], [0, 0, 1], [0, 1, 1]],
        [[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]],
        [[0, 1, 0], [1, 1, 0], [1, 0, 0], [0, 0, 0]],
    ],
    dtype=np.float64,
)


@dataclass(frozen=True, eq=False)
class Part:
    """A thing for which a model of its kind may stand in.

    Attributes:
        kind: of the thing.
        size: (3,) of the box that holds it, metres.
        target_T_part: (4, 4) from the frame of the box, on z = 0 with its front towards +y.
    """

    kind: Kind
    size: Array
    target_T_part: Array


@dataclass(frozen=True, eq=False)
class Patch:
    """Planar quadrilaterals that share a texture.

    Attributes:
        corners: (n, 4, 3) metres, counter-clockwise seen from the front.
        uv: (n, 4, 2) pixels of the texture at the corners; beyond its edges the texture goes on
            mirrored.
        texture: what is printed on them.
        surface: what they are; UNKNOWN until somebody names them, see `labelled`.
        plane: number of the structural plane that they are part of, or -1.
        part: what they make up together with others, see `as_part`.
    """

    corners: Array
    uv: Array
    texture: Texture
    surface: Surface = Surface.UNKNOWN
    plane: int = -1
    part: Part | None = None


def labelled(patches: Iterable[Patch], surface: Surface) -> tuple[Patch, ...]:
    """The same patches, those without a name called ``surface``."""
    return tuple(p if p.surface else replace(p, surface=surface) for p in patches)


def as_part(kind: Kind, patches: Iterable[Patch]) -> tuple[Patch, ...]:
    """The same patches as one thing that stands on the floor with its front towards +y."""
    own = tuple(patches)
    points = np.concatenate([p.corners.reshape(-1, 3) for p in own])
    low, high = points.min(axis=0), points.max(axis=0)
    target_T_part = np.eye(4)
    target_T_part[:2, 3] = 0.5 * (low + high)[:2]
    thing = Part(kind, np.array([*(high - low)[:2], high[2]]), target_T_part)
    return tuple(replace(p, part=thing) for p in own)


def moved(patches: Iterable[Patch], target_T_source: Array) -> tuple[Patch, ...]:
    """The same patches in another frame."""
    own = tuple(patches)
    turn, shift = target_T_source[:3, :3].T, target_T_source[:3, 3]
    parts = {
        part: replace(part, target_T_part=target_T_source @ part.target_T_part)
        for part in {p.part for p in own}
        if part is not None
    }
    return tuple(
        replace(p, corners=p.corners @ turn + shift, part=parts[p.part] if p.part else None)
        for p in own
    )


def covered(corners: Array, texture: Texture, rng: Rng) -> Patch:
    """Cut parallelograms out of a material at random places, its x axis along their longer side.

    Args:
        corners: (n, 4, 3) metres.
        texture: the material.
        rng: chooses the places.
    """
    sides = corners[:, 1::2] - corners[:, :1]
    size = np.sqrt(np.einsum("nsi,nsi->ns", sides, sides)) / texture.texel_m
    tall = size[:, 1] > size[:, 0]
    uv = _UNIT * size[:, None]
    uv[tall] = uv[tall, :, ::-1]
    uv += (rng.random((len(corners), 2)) * texture.size)[:, None]
    return Patch(corners, uv, texture)


def printed(corners: Array, texture: Texture) -> Patch:
    """Stretch a whole picture over one quadrilateral (4, 3), bottom left corner first."""
    width, height = texture.size
    uv = np.array([[0, height], [width, height], [width, 0], [0, 0]], dtype=np.float64) - 0.5
    return Patch(corners[None], uv[None], texture)


def boxes_corners(sizes: Array, bottoms: Array) -> Array:
    """(n, 6, 4, 3) of boxes (n, 3); see `box_corners`."""
    low = bottoms - sizes * [0.5, 0.5, 0.0]
    return np.asarray(_BOX_FACES * sizes[:, None, None] + low[:, None, None])


def box_corners(size: Sequence[float], bottom: Sequence[float]) -> Array:
    """(6, 4, 3) faces -y, +x, +y, -x, +z, -z of a box whose base is centred on ``bottom``."""
    return np.asarray(boxes_corners(np.array([size]), np.array([bottom]))[0])


def box(size: Sequence[float], bottom: Sequence[float], texture: Texture, rng: Rng) -> Patch:
    """A box of a material; see `box_corners`."""
    return covered(box_corners(size, bottom), texture, rng)


def boxes(
    of: Sequence[tuple[Sequence[float], Sequence[float]]], texture: Texture, rng: Rng
) -> Patch:
    """Boxes of one material, each a (size, bottom); see `box_corners`."""
    sizes, bottoms = np.array(of, np.float64).swapaxes(0, 1)
    return covered(boxes_corners(sizes, bottoms).reshape(-1, 4, 3), texture, rng)


def faced_box(
    size: Sequence[float], bottom: Sequence[float], texture: Texture, face: Texture, rng: Rng
) -> tuple[Patch, Patch]:
    """A box whose +y side, the front of furniture, shows a picture."""
    faces = box_corners(size, bottom)
    return covered(np.delete(faces, 2, axis=0), texture, rng), printed(faces[2], face)


def lathed(
    profile: Sequence[tuple[float, float]],
    bottom: Sequence[float],
    texture: Texture,
    sides: int = 16,
) -> Patch:
    """A closed solid of revolution about the z axis, with flat ends.

    Args:
        profile: (radius, height) pairs, from bottom to top.
        bottom: (3,) where the axis meets height 0.
        texture: wrapped around once, metrically.
        sides: even number of facets.
    """
    angle = 2 * np.pi * np.arange(sides + 1) / sides
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(sides + 1)], axis=-1)
    rings = [r * circle + np.array([0, 0, z]) for r, z in profile]
    quads = [
        np.stack([low[:-1], low[1:], high[1:], high[:-1]], axis=1)
        for low, high in zip(rings[:-1], rings[1:], strict=True)
    ]
    for ring, order in ((rings[0], [0, 3, 2, 1]), (rings[-1], [0, 1, 2, 3])):
        middle = np.broadcast_to(ring.mean(axis=0) * [0, 0, 1], (sides // 2, 3))
        kite = np.stack([middle, ring[:-1:2], ring[1::2], ring[2::2]], axis=1)
        quads.append(kite[:, order])
    corners = np.concatenate(quads)
    widest = max(r for r, _ in profile)
    uv = _wrapped(corners, widest, np.tile(angle[:-1], len(profile) - 1)) / texture.texel_m
    return Patch(corners + np.array(bottom), uv, texture)


def _wrapped(corners: Array, radius: float, facet_angles: Array) -> Array:
    flat = radius + corners[..., :2]
    uv = np.array(flat)
    step = facet_angles[1] - facet_angles[0]
    n = len(facet_angles)
    turn = facet_angles[:, None] + step * np.array([0, 1, 1, 0])
    uv[:n] = np.stack([radius * turn, corners[:n, :, 2]], axis=-1)
    return uv


def ball(radius: float, centre: Sequence[float], texture: Texture) -> Patch:
    """A sphere."""
    latitude = np.radians([-78, -50, -25, 0, 25, 50, 78])
    profile = [(radius * float(np.cos(a)), radius * float(np.sin(a))) for a in latitude]
    return lathed(profile, centre, texture)
