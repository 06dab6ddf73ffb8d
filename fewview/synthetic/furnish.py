"""Where the furniture of a room stands and what hangs on its walls."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from fewview.synthetic import furniture, textures
from fewview.synthetic.classes import Surface
from fewview.synthetic.decoration import HANGING
from fewview.synthetic.furniture import Piece
from fewview.synthetic.items import Patches, placement
from fewview.synthetic.plan import Opening, OpeningKind, Plan, Wall, overlaps
from fewview.synthetic.surfaces import Patch, box, box_corners, labelled, moved, printed
from fewview.synthetic.textures import Rng, muted
from fewview.types import Array

_Maker = Callable[[Rng], Piece]
_AGAINST_WALL: dict[str, tuple[_Maker, ...]] = {
    "living": (furniture.sofa, furniture.media, furniture.bookshelf, furniture.cupboard),
    "bedroom": (furniture.bed, furniture.wardrobe, furniture.cupboard, furniture.desk),
    "office": (
        furniture.desk,
        furniture.desk,
        furniture.bookshelf,
        furniture.desk,
        furniture.cupboard,
    ),
    "kitchen": (furniture.kitchen, furniture.cupboard, furniture.bookshelf, furniture.media),
}
_IN_THE_MIDDLE: dict[str, tuple[_Maker, ...]] = {
    "living": (furniture.coffee_table, furniture.armchair),
    "bedroom": (furniture.armchair,),
    "office": (furniture.dining,),
    "kitchen": (furniture.dining,),
}
_FILLERS: tuple[_Maker, ...] = (
    furniture.bookshelf, furniture.cupboard, furniture.armchair, furniture.floor_lamp,
    furniture.floor_plant, furniture.floor_plant, furniture.cartons, furniture.waste_bin,
)  # fmt: skip
_WALL_GAP = 0.025
_MAX_COVERED = 0.42


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
class _Furnishing:
    """The state of a room while it is being furnished."""

    plan: Plan
    rng: Rng
    standing: list[Standing] = field(default_factory=list)
    patches: list[Patch] = field(default_factory=list)
    taken: dict[int, list[tuple[float, float, float, float]]] = field(default_factory=dict)

    def fits(self, footprint: Array, gap: float) -> bool:
        middle = footprint.mean(axis=0)
        spread = footprint - middle
        wider = middle + spread * (1 + gap / np.abs(spread).max())
        edge = 0.5 * (footprint + np.roll(footprint, -1, axis=0))
        inside = self.plan.contains(np.concatenate([footprint, edge])).all()
        clear = not any(_contains(footprint, corner) for corner in self.plan.outline)
        free = not any(overlaps(wider, other.footprint) for other in self.standing)
        doorways = not any(overlaps(footprint, way) for way in _doorways(self.plan))
        return bool(inside and clear and free and doorways)

    def put(self, piece: Piece, world_T_piece: Array) -> None:
        footprint = footprint_of(piece, world_T_piece)
        self.standing.append(Standing(piece.name, footprint, piece.size[2]))
        self.patches += moved(piece.patches, world_T_piece)

    def blocked(self, number: int, left: float, right: float, low: float, high: float) -> bool:
        """Whether a rectangle of a wall meets an opening, a thing on it or furniture before it."""
        wall = self.plan.walls[number]
        rectangles = [_surround(o) for o in wall.openings] + self.taken.get(number, [])
        for piece in self.standing:
            local = (piece.footprint - wall.start) @ wall.world_T_wall[:2, :2]
            if (
                local[:, 1].min() < 0.3
                and local[:, 0].max() > 0
                and local[:, 0].min() < wall.length
            ):
                rectangles.append((local[:, 0].min(), local[:, 0].max(), 0.0, piece.height))
        return any(left < r[1] and right > r[0] and low < r[3] and high > r[2] for r in rectangles)


def footprint_of(piece: Piece, world_T_piece: Array) -> Array:
    """(4, 2) corners of a placed piece's footprint."""
    half = 0.5 * np.array(piece.size[:2])
    corners = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return np.asarray(corners @ world_T_piece[:2, :2].T + world_T_piece[:2, 3])


def _contains(polygon: Array, point: Array) -> bool:
    edges = np.roll(polygon, -1, axis=0) - polygon
    to_point = point - polygon
    return bool((edges[:, 0] * to_point[:, 1] - edges[:, 1] * to_point[:, 0] > 0).all())


def _surround(opening: Opening) -> tuple[float, float, float, float]:
    side = 0.3 if opening.kind is OpeningKind.WINDOW else 0.12
    return opening.left - side, opening.right + side, opening.sill - 0.1, opening.top + 0.12


def _doorways(plan: Plan) -> list[Array]:
    out = []
    for wall in plan.walls:
        for o in wall.openings:
            if o.kind is not OpeningKind.WINDOW:
                way = np.array([[o.left, 0.0], [o.right, 0.0], [o.right, 0.9], [o.left, 0.9]])
                out.append(way @ wall.world_T_wall[:2, :2].T + wall.start)
    return out


def furnish(plan: Plan, rng: Rng) -> tuple[tuple[Standing, ...], Patches]:
    """Fill a room: a theme's large pieces along the walls and in the middle, then odd ones.

    Returns:
        The pieces that stand on the floor, pairwise disjoint, and every surface that was added,
        including rugs, curtains and what hangs on the walls.
    """
    room = _Furnishing(plan, rng)
    theme = list(_AGAINST_WALL)[rng.integers(len(_AGAINST_WALL))]
    for maker in _AGAINST_WALL[theme]:
        _against_wall(room, maker(rng))
    for maker in _IN_THE_MIDDLE[theme]:
        _in_the_middle(room, maker(rng))
    for number in rng.permutation(len(_FILLERS)):
        if _covered_share(room) < _MAX_COVERED:
            _against_wall(room, _FILLERS[number](rng))
    for number, wall in enumerate(plan.walls):
        _dress_windows(room, wall)
        _hang(room, number, wall)
    return tuple(room.standing), labelled(room.patches, Surface.OTHER)


def _covered_share(room: _Furnishing) -> float:
    return sum(_area(s.footprint) for s in room.standing) / _area(room.plan.outline)


def _area(polygon: Array) -> float:
    x, y = polygon.T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def _against_wall(room: _Furnishing, piece: Piece) -> None:
    width, depth, height = piece.size
    rng = room.rng
    for _ in range(25):
        number = int(rng.integers(len(room.plan.walls)))
        wall = room.plan.walls[number]
        if wall.length < width + 0.1:
            continue
        along = rng.uniform(0.5 * width + 0.04, wall.length - 0.5 * width - 0.04)
        if room.blocked(number, along - 0.5 * width, along + 0.5 * width, 0, height):
            continue
        gap = _WALL_GAP + (0.1 if wall.openings else 0.0)
        at = wall.world_T_wall @ placement(along, 0.5 * depth + gap, 0)
        if room.fits(footprint_of(piece, at), 0.06):
            room.put(piece, at)
            return


def _in_the_middle(room: _Furnishing, piece: Piece) -> None:
    rng = room.rng
    part = room.plan.parts[rng.integers(len(room.plan.parts))]
    wall = room.plan.walls[0]
    for attempt in range(25):
        weights = rng.dirichlet(np.full(4, 4.0))
        turn = rng.integers(4) * 0.5 * np.pi + rng.normal(0, 0.15)
        turned = wall.world_T_wall[:3, :3] @ placement(0, 0, 0, turn)[:3, :3]
        x, y = weights @ part
        at = placement(x, y, 0)
        at[:3, :3] = turned
        if room.fits(footprint_of(piece, at), 0.35 if attempt < 18 else 0.1):
            room.put(piece, at)
            if rng.uniform() < 0.6:
                _spread_rug(room, piece, at)
            return


def _spread_rug(room: _Furnishing, piece: Piece, at: Array) -> None:
    size = (piece.size[0] + room.rng.uniform(0.2, 0.8), piece.size[1] + room.rng.uniform(0.2, 0.8))
    lying = Piece("rug", (), (*size, 0.006))
    if room.plan.contains(footprint_of(lying, at)).all():
        face = box_corners((*size, 0.006), (0, 0, 0))[4]
        rug = textures.rug(room.rng, size, muted(room.rng))
        room.patches += labelled(moved([printed(face, rug)], at), Surface.FLOOR)


def _dress_windows(room: _Furnishing, wall: Wall) -> None:
    rng = room.rng
    for o in wall.openings:
        if o.kind is not OpeningKind.WINDOW or rng.uniform() < 0.4:
            continue
        cloth = textures.fabric(rng, (0.6, 1.4), muted(rng))
        size = (0.26, 0.05, o.top - o.sill + 0.1)
        sides = [
            box(size, (x, 0.045, o.sill + 0.01), cloth, rng) for x in (o.left - 0.1, o.right + 0.1)
        ]
        room.patches += moved(sides, wall.world_T_wall)


def _hang(room: _Furnishing, number: int, wall: Wall) -> None:
    rng = room.rng
    for _ in range(int(6 * wall.length)):
        kind = HANGING[rng.integers(len(HANGING))]
        width, height = rng.uniform(*kind.width), rng.uniform(*kind.height)
        if wall.length < width + 0.3:
            continue
        along = rng.uniform(0.5 * width + 0.1, wall.length - 0.5 * width - 0.1)
        low = rng.uniform(0.9, max(0.95, 2.1 - height))
        ends = along - 0.5 * width - 0.04, along + 0.5 * width + 0.04
        if low + height > room.plan.height - 0.1 or room.blocked(number, *ends, low, low + height):
            continue
        room.taken.setdefault(number, []).append((*ends, low - 0.04, low + height + 0.04))
        thing = kind.make(rng, (width, height))
        room.patches += moved(thing, wall.world_T_wall @ placement(along, 0, low))
