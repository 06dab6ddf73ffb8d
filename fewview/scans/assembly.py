"""From a listing to a checked `ScanSet`: number, cameras, depth unit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fewview.errors import ScanError
from fewview.scans import depth_unit, rigs
from fewview.scans.depth_unit import DepthUnit
from fewview.scans.images import StoredImage
from fewview.scans.reader import Listing
from fewview.scans.registration import Rig, StoredFrame
from fewview.types import Scan, ScanSet

MIN_SCANS = 2
MAX_SCANS = 1000

_UNIT_SAMPLES = 5


@dataclass(frozen=True, eq=False)
class Assembly:
    """A `ScanSet` with what was found out on the way: one rig a scan; `notes` are those
    not about the unit."""

    scans: ScanSet
    unit: DepthUnit
    rigs: tuple[Rig, ...]
    notes: tuple[str, ...]


def assemble(format_name: str, where: str, listing: Listing, unit_m: float | None) -> Assembly:
    """Check a listing and make scans of it; ``where`` names it in messages.

    Raises:
        ScanError: too few or too many scans, sizes or cameras that do not fit, no sensible unit.
    """
    check_count(len(listing.shots), where)
    fitted, camera_notes = rigs.fit(listing)
    median = _median_raw([shot.depth for shot in listing.shots])
    unit = (
        depth_unit.detect(listing.unit, median, where)
        if unit_m is None
        else depth_unit.given(unit_m, median)
    )
    notes = (*listing.notes, *camera_notes)
    unit_notes = (f"depth unit {unit.metres:g} m: {unit.reason}", unit.warning)
    scans = tuple(
        Scan(shot.name, rig.target, StoredFrame(shot, rig, unit.metres))
        for shot, rig in zip(listing.shots, fitted, strict=True)
    )
    all_notes = notes + tuple(note for note in unit_notes if note)
    return Assembly(ScanSet(format_name, scans, unit.metres, all_notes), unit, fitted, notes)


def check_count(count: int, where: str) -> None:
    """Refuse numbers of scans that fewview is not made for.

    Raises:
        ScanError: fewer than two or more than a thousand.
    """
    if count < MIN_SCANS:
        raise ScanError(f"{where} holds {count} usable scan(s): at least {MIN_SCANS} are needed")
    if count > MAX_SCANS:
        raise ScanError(
            f"{where} holds {count} scans: pick a subset of 5 to 20 (at most {MAX_SCANS}) that "
            "show the whole space"
        )


def _median_raw(images: list[StoredImage]) -> float:
    chosen = np.unique(np.linspace(0, len(images) - 1, _UNIT_SAMPLES).round().astype(int))
    samples = [depth_unit.median_raw(images[i].decode(), images[i].label) for i in chosen]
    return float(np.median(samples))
