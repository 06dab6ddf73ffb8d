"""From a listing to a checked `ScanSet`: sizes, cameras, depth unit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fewview.errors import ScanError
from fewview.scans import depth_unit
from fewview.scans.cameras import Pinhole
from fewview.scans.depth_unit import DepthUnit
from fewview.scans.images import Size, StoredImage
from fewview.scans.reader import Calibration, Listing
from fewview.scans.registration import Rig, StoredFrame
from fewview.types import Intrinsics, Scan, ScanSet

MIN_SCANS = 2
MAX_SCANS = 1000
MAX_WIDTH = 640
"""Frames are reduced to this width."""

_UNIT_SAMPLES = 5
_ASPECT_TOLERANCE = 0.05


@dataclass(frozen=True, eq=False)
class Assembly:
    """A `ScanSet` with what was found out on the way; `notes` are those not about the unit."""

    scans: ScanSet
    unit: DepthUnit
    rig: Rig
    notes: tuple[str, ...]


def assemble(format_name: str, where: str, listing: Listing, unit_m: float | None) -> Assembly:
    """Check a listing and make scans of it; ``where`` names it in messages.

    Raises:
        ScanError: too few or too many scans, sizes or cameras that do not fit, no sensible unit.
    """
    check_count(len(listing.shots), where)
    colour_size = _common_size([shot.colour for shot in listing.shots], "colour")
    depth_size = _common_size([shot.depth for shot in listing.shots], "depth")
    rig, camera_notes = _rig(listing.calibration, colour_size, depth_size)
    median = _median_raw([shot.depth for shot in listing.shots])
    unit = (
        depth_unit.detect(listing.unit, median, where)
        if unit_m is None
        else depth_unit.given(unit_m, median)
    )
    notes = (*listing.notes, *camera_notes)
    unit_notes = (f"depth unit {unit.metres:g} m: {unit.reason}", unit.warning)
    scans = tuple(
        Scan(shot.name, rig.target, StoredFrame(shot, rig, unit.metres)) for shot in listing.shots
    )
    all_notes = notes + tuple(note for note in unit_notes if note)
    return Assembly(ScanSet(format_name, scans, unit.metres, all_notes), unit, rig, notes)


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


def _common_size(images: list[StoredImage], what: str) -> Size:
    sizes = [image.size() for image in images]
    common = max(set(sizes), key=sizes.count)
    for image, size in zip(images, sizes, strict=True):
        if size != common:
            raise ScanError(
                f"{image.label} is {size[0]}x{size[1]}, but the other {what} images are "
                f"{common[0]}x{common[1]}: all must be of one size and camera"
            )
    return common


def _rig(calibration: Calibration, colour: Size, depth: Size) -> tuple[Rig, list[str]]:
    notes: list[str] = []
    depth_camera = _depth_camera(calibration, colour, depth, notes)
    target = _reduced(depth_camera)
    if target.width < depth_camera.width:
        notes.append(
            f"frames are reduced from {depth[0]}x{depth[1]} to {target.width}x{target.height}"
        )
    colour_camera = _colour_camera(calibration, depth_camera, colour)
    moved = not np.allclose(calibration.colour_T_depth, np.eye(4), atol=1e-6)
    if moved or colour_camera != depth_camera.resized(*colour):
        notes.append("colour is resampled into the depth camera")
        return Rig(depth_camera, target, colour_camera, calibration.colour_T_depth), notes
    if colour != depth:
        notes.append(
            f"colour ({colour[0]}x{colour[1]}) is scaled to the view of depth "
            f"({depth[0]}x{depth[1]})"
        )
    return Rig(depth_camera, target, colour_camera, None), notes


def _depth_camera(
    calibration: Calibration, colour: Size, depth: Size, notes: list[str]
) -> Intrinsics:
    camera = calibration.depth
    if camera.size in (None, depth):
        return camera.for_image(depth, "depth")
    if camera.size == colour and calibration.colour is None:
        _check_same_view(colour, depth, camera.label)
        notes.append(f"{camera.label} is of the colour images; scaled to the depth images")
        return camera.for_image(colour, "colour").resized(*depth)
    raise ScanError(_size_message(camera, depth, "depth"))


def _colour_camera(calibration: Calibration, depth_camera: Intrinsics, colour: Size) -> Intrinsics:
    camera = calibration.colour
    if camera is None:
        size = depth_camera.width, depth_camera.height
        _check_same_view(colour, size, calibration.depth.label)
        return depth_camera.resized(*colour)
    if camera.size in (None, colour):
        return camera.for_image(colour, "colour")
    raise ScanError(_size_message(camera, colour, "colour"))


def _size_message(camera: Pinhole, size: Size, what: str) -> str:
    width, height = camera.size or size
    return (
        f"{camera.label} is for {width}x{height}, but the {what} images are {size[0]}x{size[1]}: "
        f"write the intrinsics of the {size[0]}x{size[1]} image"
    )


def _check_same_view(colour: Size, depth: Size, label: str) -> None:
    ratio = (colour[0] * depth[1]) / (colour[1] * depth[0])
    if abs(ratio - 1.0) > _ASPECT_TOLERANCE:
        raise ScanError(
            f"{label}: colour ({colour[0]}x{colour[1]}) and depth ({depth[0]}x{depth[1]}) differ "
            "in shape, so one set of intrinsics cannot serve both: register colour to depth, or "
            "store both cameras in the ScanNet layout"
        )


def _reduced(camera: Intrinsics) -> Intrinsics:
    if camera.width <= MAX_WIDTH:
        return camera
    return camera.resized(MAX_WIDTH, max(1, round(camera.height * MAX_WIDTH / camera.width)))


def _median_raw(images: list[StoredImage]) -> float:
    chosen = np.unique(np.linspace(0, len(images) - 1, _UNIT_SAMPLES).round().astype(int))
    samples = [depth_unit.median_raw(images[i].decode(), images[i].label) for i in chosen]
    return float(np.median(samples))
