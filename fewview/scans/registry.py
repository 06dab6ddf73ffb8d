"""Which reader understands a folder or file."""

from __future__ import annotations

import os
from pathlib import Path

from fewview.errors import ScanError
from fewview.scans import matterport, redwood, scannet, sens, seven_scenes, tum
from fewview.scans.reader import Reader

READERS: tuple[Reader, ...] = (sens, scannet, matterport, tum, seven_scenes, redwood)
"""All layouts, the most telling first; the first that recognises a folder reads it."""


def find_reader(path: str | os.PathLike[str]) -> tuple[Reader, Path]:
    """The reader for ``path``.

    Raises:
        ScanError: nothing is there, the folder is empty, or no layout is recognised.
    """
    where = Path(path)
    if not where.exists():
        raise ScanError(f"{where} does not exist: check the path")
    reader = _recognised(where)
    if reader is not None:
        return reader, where
    known = "; ".join(reader.LAYOUT for reader in READERS)
    if where.is_file():
        raise ScanError(f"{where} is not a file of scans: give a folder or a .sens file ({known})")
    content = sorted(where.iterdir())
    if not content:
        raise ScanError(f"{where} is empty: put scans into it ({known})")
    inside = next((p for p in content if p.is_dir() and _recognised(p)), None)
    hint = f"did you mean {inside}? " if inside else ""
    raise ScanError(f"{where} has no layout of scans that is known: {hint}known are {known}")


def _recognised(path: Path) -> Reader | None:
    return next((reader for reader in READERS if reader.recognises(path)), None)
