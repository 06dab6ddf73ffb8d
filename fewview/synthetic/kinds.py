"""Kinds of things for which models of a furniture library can stand in."""

from __future__ import annotations

import re
from dataclasses import dataclass

from fewview.synthetic.classes import Surface


@dataclass(frozen=True)
class Kind:
    """A kind of furniture.

    Attributes:
        name: of the kind.
        surface: its class.
        words: regular expression that titles of models of this kind match, in lower case.
        top: least share of its footprint that is its top, for kinds on which things stand.
    """

    name: str
    surface: Surface
    words: str
    top: float = 0.0


CHAIR = Kind("chair", Surface.CHAIR, r"(?<!arm)chair|class seat")
BENCH = Kind("bench", Surface.CHAIR, r"stool|bench|puff|ottoman")
ARMCHAIR = Kind("armchair", Surface.SOFA, r"armchair")
SOFA = Kind("sofa", Surface.SOFA, r"sofa|couch")
BED = Kind("bed", Surface.BED, r"\bbed$")
TABLE = Kind("table", Surface.TABLE, r"\btable( (with|on) .*)?$", top=0.85)
ROUND_TABLE = Kind("round table", Surface.TABLE, TABLE.words, top=0.7)
DESK = Kind("desk", Surface.TABLE, rf"\bdesk$|{TABLE.words}", top=0.85)
NIGHTSTAND = Kind("nightstand", Surface.CABINET, r"bedside|nightstand|drawers|filing", top=0.85)
CUPBOARD = Kind(
    "cupboard", Surface.CABINET, r"cabinet|dresser|drawers|chest$|stand$|island$|\bbox$", top=0.85
)
BOOKSHELF = Kind("bookshelf", Surface.CABINET, r"bookcase|shel(f|ves)$")
WARDROBE = Kind("wardrobe", Surface.CABINET, r"wardrobe|closet|high cabinet|cupboard$")
FRIDGE = Kind("fridge", Surface.CABINET, r"fridge|refrigerator|oven|washing machine|dryer")
LAMP = Kind("lamp", Surface.OTHER, r"^(little )?lamp")
BIN = Kind("bin", Surface.OTHER, r"dustbin|trash")
BOXES = Kind("boxes", Surface.OTHER, r"\b(box|crate|barrel|suitcase|basket|speaker|safe|heater)$")

KINDS = (
    CHAIR, BENCH, ARMCHAIR, SOFA, BED, TABLE, ROUND_TABLE, DESK, NIGHTSTAND, CUPBOARD, BOOKSHELF,
    WARDROBE, FRIDGE, LAMP, BIN, BOXES,
)  # fmt: skip


def kinds_of(title: str) -> tuple[Kind, ...]:
    """The kinds that a model may stand in for, by its title."""
    return tuple(kind for kind in KINDS if re.search(kind.words, title.lower()))
