"""What a reader of one layout gives: names, images still encoded, cameras, and poses apart."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from fewview.scans.cameras import Pinhole
from fewview.scans.depth_unit import DepthUnit
from fewview.scans.images import StoredImage
from fewview.types import Array


@dataclass(frozen=True)
class Shot:
    """One scan as it is stored: a name and two encoded images.

    Attributes:
        camera: the scan's own depth camera, then also that of its colour image, which shows the
            same view; None where the folder's calibration holds.
    """

    name: str
    colour: StoredImage
    depth: StoredImage
    camera: Pinhole | None = None


@dataclass(frozen=True, eq=False)
class Calibration:
    """The cameras of a folder.

    Attributes:
        depth: the depth camera; also the colour camera when `colour` is None, whose image then
            shows the same view, perhaps in another size.
        colour: the colour camera when it is another one.
        colour_T_depth: (4, 4), depth camera to colour camera.
    """

    depth: Pinhole
    colour: Pinhole | None = None
    colour_T_depth: Array = field(default_factory=lambda: np.eye(4))


@dataclass(frozen=True, eq=False)
class Listing:
    """What a folder holds, before any pixel is read.

    Attributes:
        calibration: of the shots without a camera of their own; None when there are none.
    """

    shots: tuple[Shot, ...]
    calibration: Calibration | None
    unit: DepthUnit
    notes: tuple[str, ...] = ()


class Reader(Protocol):
    """A module that understands one layout; to add one, write it and list it in `READERS`."""

    NAME: str
    """Short name, the `ScanSet.format`."""
    LAYOUT: str
    """The files it looks for, for the message about unknown folders."""

    def recognises(self, path: Path) -> bool:
        """Whether ``path``, an existing folder or file, has this layout."""

    def read(self, path: Path) -> Listing:
        """List the scans.

        Raises:
            ScanError: a file is missing, doubled or unreadable.
        """

    def truth(self, path: Path) -> dict[str, Array]:
        """``world_T_scan`` (4, 4) of the scans whose pose is known.

        Raises:
            ScanError: a pose file is unusable.
        """
