"""Colour and depth files brought together by name."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from fewview.errors import ScanError
from fewview.scans.files import natural_order
from fewview.scans.images import ColourFile, DepthFile
from fewview.scans.reader import Shot

IMAGE_FILE = re.compile(r"(?P<name>[^.].*)\.(jpg|jpeg|png)", re.IGNORECASE)


def files(folder: Path) -> list[Path]:
    """The files of a folder that are not hidden, in natural order.

    Raises:
        ScanError: the folder cannot be listed.
    """
    try:
        found = [path for path in folder.iterdir() if path.is_file()]
    except OSError as error:
        raise ScanError(f"{folder} cannot be read ({error.strerror}): check the path") from error
    visible = [path for path in found if not path.name.startswith(".")]
    return sorted(visible, key=lambda path: natural_order(path.name))


def by_name(paths: Iterable[Path], pattern: re.Pattern[str] = IMAGE_FILE) -> dict[str, Path]:
    """The files whose whole name matches, by the pattern's group ``name``.

    Raises:
        ScanError: two files share a name.
    """
    found: dict[str, Path] = {}
    for path in paths:
        match = pattern.fullmatch(path.name)
        if match is None:
            continue
        name = match["name"]
        if name in found:
            raise ScanError(
                f"{found[name]} and {path.name} are both '{name}': remove or rename one of them"
            )
        found[name] = path
    return found


def pair(colour: Mapping[str, Path], depth: Mapping[str, Path]) -> tuple[Shot, ...]:
    """One shot per name, in natural order.

    Raises:
        ScanError: a name has only one of the two images.
    """
    for here, there, missing in ((colour, depth, "depth"), (depth, colour, "colour")):
        alone = sorted(here.keys() - there.keys(), key=natural_order)
        if alone:
            more = f" (and {len(alone) - 1} more like it)" if len(alone) > 1 else ""
            raise ScanError(
                f"{here[alone[0]]} has no {missing} image of the same name{more}: "
                "add it, or remove this file"
            )
    names = sorted(colour, key=natural_order)
    return tuple(Shot(name, ColourFile(colour[name]), DepthFile(depth[name])) for name in names)
