"""What rooms are for, and the furniture that goes with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from fewview.synthetic import furniture, seating, storage, tables
from fewview.synthetic.furniture import Piece
from fewview.synthetic.textures import Rng

Maker = Callable[[Rng], Piece]


@dataclass(frozen=True)
class Theme:
    """A kind of room.

    Attributes:
        name: what it is for.
        along: pieces that stand against walls, the most important first.
        middle: pieces that stand free.
        fillers: pieces for the space that is left along the walls.
    """

    name: str
    along: tuple[Maker, ...]
    middle: tuple[Maker, ...]
    fillers: tuple[Maker, ...]


_HOME: tuple[Maker, ...] = (
    storage.bookshelf, storage.cupboard, seating.armchair, furniture.floor_lamp,
    furniture.floor_plant, furniture.floor_plant, furniture.cartons, furniture.waste_bin,
    seating.bench,
)  # fmt: skip
_WORK: tuple[Maker, ...] = (
    storage.bookshelf, storage.cupboard, storage.wardrobe, furniture.floor_plant,
    furniture.cartons, furniture.waste_bin, furniture.waste_bin, tables.desk,
)  # fmt: skip
THEMES = (
    Theme(
        "living",
        (seating.lounge, storage.media, storage.bookshelf, storage.cupboard, seating.sofa),
        (tables.dining, seating.armchair, tables.coffee_table),
        _HOME,
    ),
    Theme(
        "bed",
        (seating.sleeping, storage.wardrobe, storage.cupboard, tables.desk, storage.wardrobe),
        (seating.armchair,),
        _HOME,
    ),
    Theme(
        "office",
        (tables.desk, tables.desk, storage.bookshelf, tables.desk, storage.cupboard, tables.desk),
        (tables.desk_island, furniture.partition, tables.round_table),
        _WORK,
    ),
    Theme(
        "kitchen",
        (storage.kitchen, storage.fridge, storage.kitchen, storage.cupboard),
        (tables.dining, tables.round_table),
        _HOME,
    ),
    Theme(
        "meeting",
        (storage.media, storage.cupboard, storage.cupboard),
        (tables.conference, tables.conference),
        _WORK,
    ),
    Theme(
        "mixed",
        (seating.sleeping, tables.desk, seating.sofa, storage.kitchen, storage.wardrobe),
        (tables.dining, tables.coffee_table),
        _HOME,
    ),
)
CORRIDOR = Theme(
    "corridor",
    (storage.cupboard, storage.bookshelf),
    (),
    (seating.bench, furniture.floor_plant, storage.bookshelf, furniture.cartons),
)
