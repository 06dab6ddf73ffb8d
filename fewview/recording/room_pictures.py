"""Pictures of a completed room: rings as seen above rings as completed, and layouts from above."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fewview.completion.layout import grid
from fewview.completion.panorama import CLASSES
from fewview.recording.pictures import Image
from fewview.recording.rooms import CLASS_COLOURS
from fewview.types import Array, CompletedLayout, CompletedPanorama, FloatArray, RingScan

FARTHEST_M = 6.0
"""Depth that is drawn in the last colour, the same for all scans."""
GAP = 4
"""Rows between the seen and the completed ring."""
UNSEEN = CLASS_COLOURS[CLASSES.index("unknown")]
RING_ZOOM, CELL_PX = 3, 8
MARGIN = 12
INK, PAPER = (30, 30, 30), 255
TEXT_SCALE, LINE_PX, SWATCH_PX = 0.55, 28, 18

LAYOUT_COLOURS = np.array(
    [(205, 208, 214), (40, 62, 110), (90, 185, 105), (240, 135, 40), (205, 50, 50)], dtype=np.uint8
)
"""RGB of `grid.CLASSES` where the scan saw the cell; what is predicted is `PALE` of the way to
white."""
PALE = 0.6
CAMERA_COLOUR = (200, 0, 140)
CAMERA_CELLS = 4.0


@dataclass(frozen=True)
class RingPictures:
    """The seen ring above the completed one, `GAP` rows apart, each (2 S + GAP, 4 S).

    Attributes:
        depth: (...) float32 metres, 0 where nothing was measured.
        semantics: (...) uint8, index into `CLASSES`, 0 where nothing was measured.
        normals: (..., 3) uint8, each axis of the level frame a channel.
        confidence: (..., 3) uint8, the colours as seen above the confidence of the depth.
    """

    depth: FloatArray
    semantics: Image
    normals: Image
    confidence: Image


def ring_pictures(ring: RingScan, panorama: CompletedPanorama) -> RingPictures:
    """What a scan shows of its surroundings above what the network makes of them."""
    seen = panorama.observed
    classes = panorama.semantics.argmax(axis=-1).astype(np.uint8)
    normals = np.rint(127.5 * (panorama.normals + 1.0)).astype(np.uint8)
    sure = _mapped(panorama.confidence, cv2.COLORMAP_VIRIDIS)
    known = seen[..., None]
    return RingPictures(
        _stacked(np.where(seen, panorama.depth, np.float32(0)), panorama.depth, 0),
        _stacked(np.where(seen, classes, np.uint8(0)), classes, 0),
        _stacked(np.where(known, normals, UNSEEN), normals, UNSEEN),
        _stacked(np.where(known, ring.colour, UNSEEN), sure, UNSEEN),
    )


def panorama_picture(ring: RingScan, panorama: CompletedPanorama) -> Image:
    """One scan's 360-image for print, (H, W, 3): every channel as seen above as completed."""
    pictures = ring_pictures(ring, panorama)
    depth = _mapped(pictures.depth / FARTHEST_M, cv2.COLORMAP_TURBO)
    depth[pictures.depth == 0] = UNSEEN
    blocks = [
        _titled(f"Depth, seen and completed: dark blue 0 m to dark red {FARTHEST_M:g} m", depth),
        _titled("Normals, seen and completed: red x, green y, blue up", pictures.normals),
        _titled("Semantics, seen and completed", CLASS_COLOURS[pictures.semantics]),
        _titled("Colour seen, and confidence: dark 0 to yellow 1", pictures.confidence),
    ]
    rows = [_beside(blocks[:2]), _beside(blocks[2:])]
    legend = _legend(CLASSES, CLASS_COLOURS, rows[0].shape[1])
    return np.concatenate([*rows, legend])


def layout_picture(layout: CompletedLayout) -> Image:
    """One scan's room from above, (H, W, 3): what was seen in full colours, the rest pale.

    The camera is in the middle and looks along its arrow.
    """
    classes = layout.classes
    pale = np.rint(LAYOUT_COLOURS + PALE * (255.0 - LAYOUT_COLOURS)).astype(np.uint8)
    cells = np.where(layout.observed[..., None], LAYOUT_COLOURS[classes], pale[classes])
    picture = _enlarged(cells, CELL_PX)
    _draw_camera(picture, layout.level_T_scan)
    legend = _legend(grid.CLASSES, LAYOUT_COLOURS, picture.shape[1])
    return np.concatenate([picture, legend])


def _stacked(above: NDArray[Any], below: NDArray[Any], fill: NDArray[Any] | int) -> NDArray[Any]:
    gap = np.broadcast_to(np.asarray(fill, above.dtype), (GAP, *above.shape[1:]))
    return np.concatenate([above, gap, below])


def _mapped(share: FloatArray, colours: int) -> Image:
    """Shares (...) in 0..1 as RGB (..., 3)."""
    index = np.rint(255 * np.clip(share, 0.0, 1.0)).astype(np.uint8)
    return np.asarray(cv2.cvtColor(cv2.applyColorMap(index, colours), cv2.COLOR_BGR2RGB))


def _enlarged(image: Image, zoom: int) -> Image:
    return np.ascontiguousarray(image.repeat(zoom, axis=0).repeat(zoom, axis=1))


def _draw_camera(picture: Image, level_T_scan: Array) -> None:
    """An arrow from the middle of a layout, row 0 at +x and column 0 at +y, along the view."""
    azimuth = np.arctan2(level_T_scan[1, 2], level_T_scan[0, 2])
    middle = np.full(2, len(picture) / 2)
    ahead = CAMERA_CELLS * CELL_PX * np.array([-np.sin(azimuth), -np.cos(azimuth)])
    tip = np.rint(middle + ahead).astype(int).tolist()
    start = np.rint(middle).astype(int).tolist()
    for colour, width in (((255, 255, 255), 7), (CAMERA_COLOUR, 3)):
        cv2.circle(picture, start, 5 + width // 3, colour, -1, cv2.LINE_AA)
        cv2.arrowedLine(picture, start, tip, colour, width, cv2.LINE_AA, tipLength=0.35)


def _titled(title: str, stacked: Image) -> Image:
    image = _enlarged(stacked, RING_ZOOM)
    head = np.full((LINE_PX, image.shape[1], 3), PAPER, dtype=np.uint8)
    _write(head, title, 0)
    return np.concatenate([head, image])


def _beside(images: Sequence[Image]) -> Image:
    bars = [np.full((len(images[0]), MARGIN, 3), PAPER, dtype=np.uint8)] * (len(images) - 1)
    parts = [images[0], *(p for pair in zip(bars, images[1:], strict=True) for p in pair)]
    return np.concatenate(parts, axis=1)


def _legend(names: Sequence[str], colours: Image, width: int) -> Image:
    """Swatches with the names of classes in rows of one picture's width."""
    places, x, y = [], 0, 0
    for name in names:
        (text, _), _ = cv2.getTextSize(name, cv2.FONT_HERSHEY_SIMPLEX, TEXT_SCALE, 1)
        needed = SWATCH_PX + 6 + text + MARGIN
        if x + needed > width:
            x, y = 0, y + LINE_PX
        places.append((x, y))
        x += needed
    strip = np.full((y + LINE_PX, width, 3), PAPER, dtype=np.uint8)
    for name, colour, (x, y) in zip(names, colours, places, strict=True):
        strip[y + 5 : y + 5 + SWATCH_PX, x : x + SWATCH_PX] = colour
        _write(strip[y : y + LINE_PX], name, x + SWATCH_PX + 6)
    return strip


def _write(line: Image, text: str, x: int) -> None:
    place = (x, LINE_PX - 9)
    cv2.putText(line, text, place, cv2.FONT_HERSHEY_SIMPLEX, TEXT_SCALE, INK, 1, cv2.LINE_AA)
