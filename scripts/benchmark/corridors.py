"""Corridors whose halves look alike: what is seen in one half may as well be in the other."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum

import numpy as np

from fewview.errors import FewviewError
from fewview.synthetic.camera import Viewpoint, overlap, sample_viewpoints
from fewview.synthetic.classes import Surface
from fewview.synthetic.decoration import decorate
from fewview.synthetic.furnish import furnish
from fewview.synthetic.plan import Opening, OpeningKind, Plan, Wall
from fewview.synthetic.room import Room
from fewview.synthetic.shapes import rectangle
from fewview.synthetic.shell import Structure, shell
from fewview.synthetic.surfaces import Patch, labelled, lathed, moved
from fewview.synthetic.textures import Rng, Texture, plain
from fewview.types import Array, BoolArray, Intrinsics

CUT_M = 0.04
"""Surfaces this close to the middle of the corridor belong to the wall that is left out there."""
LIKE_OVERLAP = 0.25
"""A view is tied to an earlier one of similar direction by at least this overlap."""
LIKE_COSINE = 0.5
HALF_SHARE = 0.97
"""A view shows one half when this share of what it sees is there."""
MIDDLE_SHARE = 0.3
"""A view shows the middle when it sees this share at least of either half."""
POOL = 160


class Likeness(StrEnum):
    """How the second half of a corridor follows from the first."""

    MIRRORED = "mirrored"
    TURNED = "turned"


_SECOND_T_FIRST = {
    Likeness.MIRRORED: np.diag([-1.0, 1.0, 1.0, 1.0]),
    Likeness.TURNED: np.diag([-1.0, -1.0, 1.0, 1.0]),
}


def corridor(seed: int, likeness: Likeness) -> Room:
    """A furnished corridor with a door at either end; its middle is x = 0, its axis is x.

    Args:
        seed: of the first half (x < 0).
        likeness: the second half is the first, mirrored in x = 0, writing and all, or turned by
            180 degrees about the z axis.
    """
    rng = np.random.default_rng(seed)
    half = _half_plan(rng)
    furnished = furnish(half, rng)
    lamp, glass = _lamp(half, rng)
    made = (*shell(half, rng, Structure()), *furnished.patches, *decorate(furnished), *glass)
    first = [cut for patch in made if len((cut := _before_the_middle(patch)).corners)]
    second_T_first = _SECOND_T_FIRST[likeness]
    lamps = np.stack([lamp, lamp @ second_T_first[:3, :3].T])
    outline = np.array(rectangle(*half.outline.min(axis=0), *-half.outline.min(axis=0)))
    ends = np.roll(outline, -1, axis=0)
    walls = tuple(Wall(a, b, ()) for a, b in zip(outline, ends, strict=True))
    plan = Plan(outline, outline[None], half.ceilings, walls)
    return _assembled(plan, lamps, [*first, *moved(first, second_T_first)])


def corridor_views(
    room: Room, each: int, middle: int, seed: int, intrinsics: Intrinsics
) -> list[Array]:
    """Poses of views of a corridor: of the first half, of the middle, of the second half.

    No view of one half sees anything of the other. Views of one group overlap.

    Args:
        room: from `corridor`.
        each: views of either half.
        middle: views that see both.
        seed: chooses them.
        intrinsics: of the camera.

    Returns:
        (4, 4) world_T_scan each.

    Raises:
        FewviewError: the corridor has too few such views; take another seed.
    """
    pool = sample_viewpoints(room, POOL, np.random.default_rng(seed), intrinsics)
    second = np.array([(view.areas * (view.points[:, 0] > 0)).sum() for view in pool])
    second /= [view.areas.sum() for view in pool]
    groups = (
        (second < 1.0 - HALF_SHARE, each),
        ((second > MIDDLE_SHARE) & (second < 1.0 - MIDDLE_SHARE), middle),
        (second > HALF_SHARE, each),
    )
    poses: list[Array] = []
    for allowed, count in groups:
        poses += [view.pose for view in _tied(room, pool, allowed, count, intrinsics)]
    return poses


def _tied(
    room: Room, pool: list[Viewpoint], allowed: BoolArray, count: int, intrinsics: Intrinsics
) -> list[Viewpoint]:
    """The first ``count`` allowed views each of which looks much like one before it."""
    waiting = [pool[i] for i in np.flatnonzero(allowed)]
    for start in range(len(waiting)):
        chosen = waiting[start : start + 1]
        for view in waiting[:start] + waiting[start + 1 :]:
            if len(chosen) < count and any(_alike(room, view, c, intrinsics) for c in chosen):
                chosen.append(view)
        if len(chosen) >= count:
            return chosen[:count]
    if count == 0:
        return []
    raise FewviewError("the corridor has too few views that overlap; take another seed")


def _alike(room: Room, one: Viewpoint, other: Viewpoint, intrinsics: Intrinsics) -> bool:
    near = float(one.pose[:3, 2] @ other.pose[:3, 2]) > LIKE_COSINE
    return near and overlap(room, one, other, intrinsics) > LIKE_OVERLAP


def _half_plan(rng: Rng) -> Plan:
    """A box with a door in its end wall and, in place of the opposite wall, nothing."""
    length, width, height = rng.uniform(3.2, 4.2), rng.uniform(1.9, 2.4), rng.uniform(2.3, 2.8)
    outline = np.array(rectangle(-length, -0.5 * width, 0.0, 0.5 * width))
    open_end = Opening(OpeningKind.PASSAGE, 0.05, width - 0.05, 0.0, height - 0.05, CUT_M)
    openings = (
        (_door(rng.uniform(0.6, length - 1.5)),),
        (open_end,),
        (),
        (_door(0.5 * width - 0.45 + rng.uniform(-0.1, 0.1)),),
    )
    ends = np.roll(outline, -1, axis=0)
    walls = tuple(Wall(a, b, o) for a, b, o in zip(outline, ends, openings, strict=True))
    return Plan(outline, outline[None], (np.array([[0.0, 0.0, height]]),), walls)


def _door(left: float) -> Opening:
    return Opening(OpeningKind.DOOR, left, left + 0.9, 0.0, 2.05, 0.04)


def _lamp(half: Plan, rng: Rng) -> tuple[Array, Iterable[Patch]]:
    """Where light comes from, and the shade around it."""
    x, y = half.outline.mean(axis=0)
    glass = lathed([(0.2, -0.09), (0.2, 0.0)], (x, y, half.height), plain(rng, np.full(3, 250.0)))
    return np.array([x, y, half.height - 0.25]), labelled([glass], Surface.OTHER)


def _before_the_middle(patch: Patch) -> Patch:
    """Without what stands in the place of the wall that is left out."""
    kept = patch.corners[..., 0].min(axis=1) < -CUT_M
    return Patch(patch.corners[kept], patch.uv[kept], patch.texture, patch.surface)


def _assembled(plan: Plan, lamps: Array, patches: list[Patch]) -> Room:
    textures: dict[int, Texture] = {id(p.texture): p.texture for p in patches}
    numbers = {key: number for number, key in enumerate(textures)}
    counts = [len(p.corners) for p in patches]
    return Room(
        plan=plan,
        standing=(),
        lamps=lamps,
        ambient=0.6,
        corners=np.concatenate([p.corners for p in patches]),
        uv=np.concatenate([p.uv for p in patches]).astype(np.float32),
        texture=np.repeat([numbers[id(p.texture)] for p in patches], counts),
        texel_m=np.repeat(np.array([p.texture.texel_m for p in patches], np.float32), counts),
        surface=np.repeat(np.array([p.surface for p in patches], np.uint8), counts),
        plane=np.full(sum(counts), -1),
        structure=Structure(),
        textures=tuple(textures.values()),
    )
