"""Where the furniture of a room stands."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from fewview.synthetic import textures
from fewview.synthetic.classes import Surface
from fewview.synthetic.furniture import Piece, column
from fewview.synthetic.items import Patches, placement
from fewview.synthetic.plan import OpeningKind, Plan, Wall, overlap_any
from fewview.synthetic.surfaces import Patch, box_corners, labelled, moved, printed
from fewview.synthetic.textures import Rng, muted
from fewview.synthetic.themes import CORRIDOR, THEMES, Theme
from fewview.types import Array

_TRIES = 25
_GAP_M = 0.06
_MIDDLE_GAPS_M = (0.5, 0.35, 0.1)
_CORRIDOR_M = 1.8


@dataclass(frozen=True)
class Standing:
    """A piece in its place.

    Attributes:
        name: of the piece.
        footprint: (4, 2) corners on the floor, metres.
        height: of the box that holds it.
    """

    name: str
    footprint: Array
    height: float


@dataclass
class Furnishing:
    """The state of a room while it is being furnished."""

    plan: Plan
    rng: Rng
    doorways: Array
    exchange: Callable[[Patches], Patches] | None = None
    standing: list[Standing] = field(default_factory=list)
    patches: list[Patch] = field(default_factory=list)

    def fits(self, piece: Piece, footprint: Array, gap: float) -> bool:
        """Whether a piece may stand there with ``gap`` metres to other pieces."""
        edge = 0.5 * (footprint + footprint[[1, 2, 3, 0]])
        middle = footprint.mean(axis=0)
        spread = footprint - middle
        wider = middle + spread * (1 + gap / np.abs(spread).max())
        others = np.array([other.footprint for other in self.standing]).reshape(-1, 4, 2)
        return not (
            overlap_any(wider, others)
            or overlap_any(footprint, self.doorways)
            or not self.plan.contains(np.concatenate([footprint, edge])).all()
            or _contains_any(footprint, self.plan.outline)
            or self.plan.height_at(footprint).min() < piece.size[2] + 0.01
        )

    def put(self, piece: Piece, world_T_piece: Array) -> None:
        """Stand a piece there."""
        footprint = footprint_of(piece, world_T_piece)
        self.standing.append(Standing(piece.name, footprint, piece.size[2]))
        own = self.exchange(piece.patches) if self.exchange else piece.patches
        self.patches += moved(own, world_T_piece)

    def covered_share(self) -> float:
        """Part of the floor under furniture."""
        return sum(_area(s.footprint) for s in self.standing) / _area(self.plan.outline)


def footprint_of(piece: Piece, world_T_piece: Array) -> Array:
    """(4, 2) corners of a placed piece's footprint."""
    half = 0.5 * np.array(piece.size[:2])
    corners = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return np.asarray(corners @ world_T_piece[:2, :2].T + world_T_piece[:2, 3])


def _contains_any(polygon: Array, points: Array) -> bool:
    edges = np.roll(polygon, -1, axis=0) - polygon
    way = points[:, None] - polygon
    return bool((edges[:, 0] * way[..., 1] - edges[:, 1] * way[..., 0] > 0).all(axis=1).any())


def _area(polygon: Array) -> float:
    x, y = polygon.T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def _doorways(plan: Plan) -> Array:
    out = []
    for wall in plan.walls:
        for o in wall.openings:
            if o.kind is not OpeningKind.WINDOW:
                way = np.array([[o.left, 0.0], [o.right, 0.0], [o.right, 0.9], [o.left, 0.9]])
                out.append(wall.to_world(way))
    return np.array(out).reshape(-1, 4, 2)


def furnish(
    plan: Plan, rng: Rng, exchange: Callable[[Patches], Patches] | None = None
) -> Furnishing:
    """Fill one room: what its theme asks for along the walls and in the middle, then odd things.

    Args:
        plan: of the room.
        rng: chooses the furniture and its places.
        exchange: puts other surfaces in the place of a piece's, within the same box.

    Returns:
        The pieces that stand on the floor, pairwise disjoint, and their surfaces, rugs included.
    """
    room = Furnishing(plan, rng, _doorways(plan), exchange)
    theme = _theme(plan, rng)
    if _area(plan.outline) > 18 and rng.uniform() < 0.2:
        _pillar(room)
    middle_first = theme.name == "meeting" or rng.uniform() < 0.3
    for maker in theme.middle if middle_first else ():
        _in_the_middle(room, maker(rng))
    for maker in theme.along:
        if rng.uniform() < 0.85:
            _against_wall(room, maker(rng))
    for maker in () if middle_first else theme.middle:
        if rng.uniform() < 0.75:
            _in_the_middle(room, maker(rng))
    fullest = rng.uniform(0.2, 0.5)
    for number in rng.permutation(len(theme.fillers)):
        if room.covered_share() < fullest:
            _against_wall(room, theme.fillers[number](rng))
    room.patches = list(labelled(room.patches, Surface.OTHER))
    return room


def _theme(plan: Plan, rng: Rng) -> Theme:
    if min(wall.length for wall in plan.walls) < _CORRIDOR_M and len(plan.walls) == 4:
        return CORRIDOR
    return THEMES[rng.integers(len(THEMES))]


def _pillar(room: Furnishing) -> None:
    rng = room.rng
    for _ in range(_TRIES):
        spot = rng.dirichlet(np.full(4, 2.0)) @ room.plan.parts[0]
        height = float(room.plan.height_at(spot[None])[0])
        pillar = column(rng, height - 0.02)
        at = room.plan.walls[0].world_T_wall.copy()
        at[:3, 3] = *spot, 0.02
        if room.fits(pillar, footprint_of(pillar, at), _GAP_M):
            room.put(pillar, at)
            return


def _against_wall(room: Furnishing, piece: Piece) -> None:
    width, depth, height = piece.size
    rng, walls = room.rng, room.plan.walls
    lengths = np.array([wall.length for wall in walls])
    usable = np.flatnonzero(lengths > width + 0.1)
    for number in rng.choice(usable, _TRIES) if len(usable) else ():
        wall = walls[number]
        along = _along(rng, wall, width)
        if _before_opening(wall, along - 0.5 * width, along + 0.5 * width, height):
            continue
        gap = rng.uniform(0.02, 0.06) + (0.1 if wall.openings else 0.0)
        at = wall.world_T_wall @ placement(along, 0.5 * depth + gap, 0, rng.normal(0, 0.01))
        if room.fits(piece, footprint_of(piece, at), _GAP_M):
            room.put(piece, at)
            return


def _along(rng: Rng, wall: Wall, width: float) -> float:
    """Where along a wall: often in a corner, else anywhere."""
    low, high = 0.5 * width + 0.04, wall.length - 0.5 * width - 0.04
    if rng.uniform() < 0.35:
        return low + rng.uniform(0, 0.05) if rng.uniform() < 0.5 else high - rng.uniform(0, 0.05)
    return float(rng.uniform(low, high))


def _before_opening(wall: Wall, left: float, right: float, height: float) -> bool:
    for o in wall.openings:
        side = 0.2 if o.kind is OpeningKind.WINDOW else 0.12
        if left < o.right + side and right > o.left - side and height > o.sill - 0.1:
            return True
    return False


def _in_the_middle(room: Furnishing, piece: Piece) -> None:
    rng = room.rng
    part = room.plan.parts[0] if rng.uniform() < 0.7 else rng.choice(room.plan.parts)
    wall = room.plan.walls[rng.integers(len(room.plan.walls))]
    for attempt in range(_TRIES):
        turn = rng.integers(4) * 0.5 * np.pi + rng.normal(0, 0.1)
        at = wall.world_T_wall @ placement(0, 0, 0, turn)
        at[:2, 3] = rng.dirichlet(np.full(4, 4.0)) @ part
        gap = _MIDDLE_GAPS_M[min(attempt // 8, 2)]
        if room.fits(piece, footprint_of(piece, at), gap):
            room.put(piece, at)
            if rng.uniform() < 0.5:
                _spread_rug(room, piece, at)
            return


def _spread_rug(room: Furnishing, piece: Piece, at: Array) -> None:
    size = (piece.size[0] + room.rng.uniform(0.2, 0.8), piece.size[1] + room.rng.uniform(0.2, 0.8))
    lying = Piece("rug", (), (*size, 0.006))
    if room.plan.contains(footprint_of(lying, at)).all():
        face = box_corners((*size, 0.006), (0, 0, 0))[4]
        rug = printed(face, textures.rug(room.rng, size, muted(room.rng)))
        room.patches += labelled(moved([rug], at), Surface.FLOOR)
