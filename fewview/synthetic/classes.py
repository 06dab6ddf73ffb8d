"""What surfaces are, what the floor plan shows, and which planes hold a room together."""

from __future__ import annotations

from enum import IntEnum


class Surface(IntEnum):
    """The class of a surface, as semantic images hold it."""

    UNKNOWN = 0
    WALL = 1
    FLOOR = 2
    CEILING = 3
    DOOR = 4
    WINDOW = 5
    TABLE = 6
    CHAIR = 7
    SOFA = 8
    BED = 9
    CABINET = 10
    OTHER = 11


class Ground(IntEnum):
    """The class of a cell of a top-down layout."""

    UNKNOWN = 0
    WALL = 1
    FREE = 2
    FURNITURE = 3
    DOOR = 4


class PlaneKind(IntEnum):
    """The kind of a structural plane; NONE pads lists."""

    NONE = 0
    FLOOR = 1
    CEILING = 2
    WALL = 3
