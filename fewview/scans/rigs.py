"""The cameras of every scan: its own, or those of the folder turned or scaled to its images."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fewview.errors import ScanError
from fewview.geometry import se3
from fewview.scans import notes
from fewview.scans.cameras import Pinhole
from fewview.scans.images import Size, StoredImage
from fewview.scans.notes import Remark
from fewview.scans.reader import Calibration, Listing, Shot
from fewview.scans.registration import Rig
from fewview.types import Intrinsics

MAX_LONG_SIDE = 640
"""Frames are reduced until no side is longer."""

_SAME_VIEW_TOLERANCE = 0.05
_SCALING_TOLERANCE = 0.01
_QUARTER_TURN = se3.pose(
    np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.zeros(3)
)
"""Motion of the camera frame when the image is turned counter-clockwise by 90 degrees."""


def fit(listing: Listing) -> tuple[tuple[Rig, ...], list[str]]:
    """The rig of each scan, and what was assumed.

    Each combination of image sizes and calibration is checked once. A calibration of the folder
    belongs to one image size; images of the transposed size are taken as turned by 90 degrees,
    others of the same aspect ratio as resampled.

    Raises:
        ScanError: a camera fits no image, or an image fits no camera.
    """
    common = _common(listing)
    known: dict[tuple[Size, Size, Pinhole | None], tuple[Rig, list[Remark]]] = {}
    rigs: list[Rig] = []
    remarks: dict[str, list[Remark]] = {}
    for shot in listing.shots:
        key = (shot.colour.size(), shot.depth.size(), shot.camera)
        if key not in known:
            known[key] = _rig(shot, _calibration(shot, common))
        rig, remarks[shot.name] = known[key]
        rigs.append(rig)
    return tuple(rigs), notes.lines(remarks)


def _calibration(shot: Shot, common: Calibration | None) -> Calibration:
    if shot.camera is not None:
        return Calibration(shot.camera)
    if common is None:
        raise ValueError(f"the reader gave no calibration for '{shot.name}'")
    return common


def _common(listing: Listing) -> Calibration | None:
    """The folder's calibration with the image sizes that it belongs to."""
    shots = [shot for shot in listing.shots if shot.camera is None]
    calibration = listing.calibration
    if calibration is None or not shots:
        return calibration
    depth = _sized(calibration.depth, [shot.depth.size() for shot in shots])
    colour = calibration.colour and _sized(
        calibration.colour, [shot.colour.size() for shot in shots]
    )
    return replace(calibration, depth=depth, colour=colour)


def _sized(camera: Pinhole, sizes: Sequence[Size]) -> Pinhole:
    """The camera with its image size: the commonest, upright or turned, that it is central in."""
    if camera.size is not None:
        return camera
    shapes = Counter((max(size), min(size)) for size in sizes)
    upright = [min(shape, shape[::-1], key=camera.off_centre) for shape, _ in shapes.most_common()]
    commonest = Counter(sizes).most_common(1)[0][0]
    return replace(camera, size=next((s for s in upright if camera.is_central(s)), commonest))


def _rig(shot: Shot, calibration: Calibration) -> tuple[Rig, list[Remark]]:
    colour_size, remarks = shot.colour.size(), list[Remark]()
    depth, depth_turned = _fitted(calibration.depth, shot.depth, "depth", remarks)
    target = _reduced(depth)
    if target != depth:
        remarks.append(Remark("frames are reduced", f"{_text(depth)} to {_text(target)}"))
    if calibration.colour is None:
        _check_same_view(shot)
        colour = depth.resized(*colour_size)
    else:
        colour, colour_turned = _fitted(calibration.colour, shot.colour, "colour", remarks)
        _check_turned_alike(shot, depth_turned, colour_turned)
    colour_T_depth = calibration.colour_T_depth
    if depth_turned:
        colour_T_depth = _QUARTER_TURN @ colour_T_depth @ se3.inverse(_QUARTER_TURN)
    sizes = f"{_text(colour)} to {_text(depth)}"
    moved = not np.allclose(colour_T_depth, np.eye(4), atol=1e-6)
    if moved or colour != depth.resized(*colour_size):
        remarks.append(Remark("colour is resampled into the depth camera", sizes))
        return Rig(depth, target, colour, colour_T_depth), remarks
    if _size(colour) != _size(depth):
        remarks.append(Remark("colour is scaled to the view of depth", sizes))
    return Rig(depth, target, colour, None), remarks


def _fitted(
    camera: Pinhole, image: StoredImage, what: str, remarks: list[Remark]
) -> tuple[Intrinsics, bool]:
    """The camera of an image, and whether it was turned to fit."""
    size = image.size()
    fitted = camera.for_image(camera.size or size, what)
    turned = not _same_aspect(_size(fitted), size) and _same_aspect(_size(fitted)[::-1], size)
    if turned:
        fitted = fitted.quarter_turned()
        text = f"{camera.label} is turned by 90 degrees counter-clockwise to fit {what} images"
        remarks.append(Remark(text, _text(fitted)))
    if not _same_aspect(_size(fitted), size):
        raise ScanError(
            f"{camera.label} is for {_text(fitted)}, but {image.label} is {size[0]}x{size[1]}: "
            f"write the intrinsics of the {size[0]}x{size[1]} image (for one scan alone as "
            "NAME.intrinsics.txt in the 7-Scenes layout)"
        )
    if _size(fitted) != size:
        scaled = fitted.resized(*size)
        text = f"{camera.label} is scaled to the {what} images"
        remarks.append(Remark(text, f"{_text(fitted)} to {_text(scaled)}"))
        fitted = scaled
    return fitted, turned


def _check_turned_alike(shot: Shot, depth_turned: bool, colour_turned: bool) -> None:
    if depth_turned != colour_turned:
        turned, other = shot.depth.label, shot.colour.label
        if colour_turned:
            turned, other = other, turned
        raise ScanError(f"{turned} is turned by 90 degrees, but {other} is not: turn both alike")


def _check_same_view(shot: Shot) -> None:
    colour, depth = shot.colour.size(), shot.depth.size()
    ratio = (colour[0] * depth[1]) / (colour[1] * depth[0])
    if abs(ratio - 1.0) > _SAME_VIEW_TOLERANCE:
        raise ScanError(
            f"{shot.colour.label} ({colour[0]}x{colour[1]}) and {shot.depth.label} "
            f"({depth[0]}x{depth[1]}) differ in shape, so one set of intrinsics cannot serve both: "
            "register colour to depth, or store both cameras in the ScanNet layout"
        )


def _same_aspect(a: Size, b: Size) -> bool:
    return abs((a[0] * b[1]) / (a[1] * b[0]) - 1.0) <= _SCALING_TOLERANCE


def _reduced(camera: Intrinsics) -> Intrinsics:
    share = MAX_LONG_SIDE / max(_size(camera))
    if share >= 1.0:
        return camera
    return camera.resized(*(max(1, round(side * share)) for side in _size(camera)))


def _size(camera: Intrinsics) -> Size:
    return camera.width, camera.height


def _text(camera: Intrinsics) -> str:
    return f"{camera.width}x{camera.height}"
