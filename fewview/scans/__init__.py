"""Scans from disk: `load` for pixels and cameras, `truth` for evaluation, `inspect` for people."""

from __future__ import annotations

import os

from fewview.scans.assembly import assemble
from fewview.scans.inspection import Inspection, inspect
from fewview.scans.registry import READERS, find_reader
from fewview.scans.writer import write
from fewview.types import Array, ScanSet

__all__ = ["READERS", "Inspection", "inspect", "load", "truth", "write"]


def load(path: str | os.PathLike[str], depth_unit_m: float | None = None) -> ScanSet:
    """Recognise the layout of ``path`` and list its scans; pixels are read later.

    Args:
        path: a folder, or a ``.sens`` file.
        depth_unit_m: metres per raw depth value; detected when not given.

    Raises:
        ScanError: anything that would keep the scans from being used, in one line.
    """
    reader, where = find_reader(path)
    return assemble(reader.NAME, str(where), reader.read(where), depth_unit_m).scans


def truth(path: str | os.PathLike[str]) -> dict[str, Array]:
    """Ground-truth poses found beside the scans, for `evaluate` only.

    Returns:
        ``world_T_scan`` (4, 4), camera-to-world of the depth camera, by scan name; scans without
        a finite pose are left out.

    Raises:
        ScanError: unknown layout or an unusable pose file.
    """
    reader, where = find_reader(path)
    return reader.truth(where)
