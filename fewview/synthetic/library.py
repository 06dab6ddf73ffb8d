"""A library of furniture models: Sweet Home 3D's catalogues, as Debian's package installs them."""

from __future__ import annotations

import hashlib
import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from pathlib import Path

import numpy as np

from fewview.errors import FewviewError
from fewview.synthetic.kinds import Kind, kinds_of
from fewview.synthetic.models import Shape, load_shape
from fewview.synthetic.splits import Split
from fewview.types import Array

PACKAGE = "sweethome3d-furniture"
"""Debian's package."""
FOLDER = Path("/usr/share/sweethome3d/furniture")
"""Where it puts its catalogues."""
_CATALOGUE = "PluginFurnitureCatalog.properties"
_PROPERTY = re.compile(r"^(\w+)(?:#(\d+))?\s*=[ \t]*(.*?)\s*$", re.MULTILINE)
_DRAWN = slice(16, 24)
"""Bytes of a name's hash that decide; these give every split of Debian's models every class."""
_SHARES: tuple[tuple[float, Split], ...] = ((0.7, "train"), (0.85, "validation"), (1.0, "test"))


@dataclass(frozen=True, eq=False)
class Model:
    """A model of a catalogue.

    Attributes:
        name: its id, no other model's.
        title: what it is, in English.
        category: the room or purpose under which its catalogue lists it.
        author: who made it.
        collection: name of its catalogue.
        licence: of its catalogue, with the copyright.
        kinds: what it may stand in for.
        size: (3,) width, depth and height, metres.
        archive: the catalogue's file.
        member: the OBJ file in it.
        turn: (3, 3) rotation that makes it upright with y up and its front towards z.
    """

    name: str
    title: str
    category: str
    author: str
    collection: str
    licence: str
    kinds: tuple[Kind, ...]
    size: Array
    archive: Path
    member: str
    turn: Array

    @property
    def split(self) -> Split:
        """The only split in whose rooms it may stand, by its name alone."""
        digest = hashlib.sha256(self.name.encode()).digest()
        chance = int.from_bytes(digest[_DRAWN], "big") / 2**64
        return next(split for share, split in _SHARES if chance < share)

    @cached_property
    def shape(self) -> Shape | None:
        """Its surfaces, None where they cannot be used."""
        return load_shape(self.archive, self.member, self.turn, self.size)


@dataclass(frozen=True, eq=False)
class Library:
    """Models of all catalogues in a folder.

    Attributes:
        models: those that may stand in for something, in the order of their names.
        fingerprint: of the catalogues' contents.
    """

    models: tuple[Model, ...]
    fingerprint: str

    def of(self, split: Split) -> tuple[Model, ...]:
        """The models that may stand in a split's rooms; the demo's have those of the tests."""
        wanted = "test" if split == "demo" else split
        return tuple(model for model in self.models if model.split == wanted)

    def credits(self) -> tuple[str, ...]:
        """A line per collection: its licence, and whose how many models."""
        lines = []
        ordered = sorted(self.models, key=lambda model: (model.collection, model.licence))
        for (name, licence), group in groupby(ordered, lambda m: (m.collection, m.licence)):
            authors = [model.author for model in group]
            by = ", ".join(sorted(set(authors), key=str.lower))
            lines.append(f"{name}: {len(authors)} models by {by}. {licence}")
        return tuple(lines)


def read_library(folder: Path = FOLDER) -> Library:
    """Read the catalogues (``*.sh3f``) of a folder; their models are read when they are used.

    Raises:
        FewviewError: there is no such folder, or nothing in it that can furnish a room.
    """
    models: list[Model] = []
    contents = hashlib.sha256()
    for archive in sorted(folder.glob("*.sh3f")):
        try:
            with zipfile.ZipFile(archive) as files:
                models += _models(archive, files.read(_CATALOGUE).decode("latin-1"))
                for entry in sorted(files.infolist(), key=lambda e: e.filename):
                    contents.update(f"{archive.name}/{entry.filename} {entry.CRC}\n".encode())
        except (OSError, KeyError, zipfile.BadZipFile) as error:
            raise FewviewError(f"{archive}: not a furniture catalogue ({error})") from error
    if not models:
        raise FewviewError(
            f"no furniture models in {folder}; install Debian's package {PACKAGE} "
            f"(it fills {FOLDER}) or name a folder of .sh3f catalogues"
        )
    models.sort(key=lambda model: model.name)
    return Library(tuple(models), contents.hexdigest()[:16])


def _models(archive: Path, catalogue: str) -> list[Model]:
    common: dict[str, str] = {}
    numbered: dict[int, dict[str, str]] = {}
    for key, number, value in _PROPERTY.findall(catalogue):
        said = numbered.setdefault(int(number), {}) if number else common
        said[key] = value.encode("latin-1").decode("unicode_escape")
    models = [_model(archive, common, numbered[number]) for number in sorted(numbered)]
    return [model for model in models if model is not None]


def _model(archive: Path, common: Mapping[str, str], said: Mapping[str, str]) -> Model | None:
    """A model that stands on the floor and is of a known kind."""
    title = said.get("name", "")
    kinds = kinds_of(title)
    try:
        size = np.array([float(said[key]) for key in ("width", "depth", "height")]) / 100
        turn = np.array([float(n) for n in said.get("modelRotation", "1 0 0 0 1 0 0 0 1").split()])
        floating = float(said.get("elevation", 0)) > 0 or said.get("doorOrWindow") == "true"
        if floating or not kinds or size.min() <= 0:
            return None
        return Model(
            name=said.get("id", f"{archive.name}#{said['model']}"),
            title=title,
            category=said.get("category", ""),
            author=said.get("creator", "unknown"),
            collection=common.get("name", archive.stem),
            licence=common.get("license", "unknown licence"),
            kinds=kinds,
            size=size,
            archive=archive,
            member=said["model"].lstrip("/"),
            turn=turn.reshape(3, 3),
        )
    except (KeyError, ValueError):
        return None
