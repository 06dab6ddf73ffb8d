"""Pictures with words on a white page: captions, messages, and the grid of a figure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from benchmark.rendering import BACKGROUND, Picture

Rgb = tuple[int, int, int]

TEXT_COLOUR: Rgb = (40, 40, 40)
CAPTION_PX, CAPTION_FONT, TITLE_FONT, GAP_PX, FRAME_PX = 30, 18, 21, 12, 7
PALETTE = 256


def grid(
    images: Sequence[Sequence[Picture]], column_titles: Sequence[str], row_titles: Sequence[str]
) -> Picture:
    """Lay rows of pictures of one height out on white, with titles above and on the left.

    Titles may have several lines. Rows may be shorter than the longest; the pictures of a column
    may differ in width.
    """
    font = _font(TITLE_FONT)
    top = max(_extent(title, font)[1] for title in column_titles) + 2 * GAP_PX
    left = max(_extent(title, font)[0] for title in row_titles) + 2 * GAP_PX
    wide = [_extent(title, font)[0] for title in column_titles]
    for row in images:
        wide[: len(row)] = [max(w, p.shape[1]) for w, p in zip(wide, row, strict=False)]
    x = left + np.cumsum([0] + [width + GAP_PX for width in wide])
    step = images[0][0].shape[0] + GAP_PX
    page = Image.new("RGB", (int(x[-1]), top + step * len(images)), "white")
    draw = ImageDraw.Draw(page)
    for at, width, title in zip(x, wide, column_titles, strict=False):
        middle = (float(at + width / 2), top - GAP_PX)
        draw.multiline_text(middle, title, TEXT_COLOUR, font, anchor="md", align="center")
    for i, (row, title) in enumerate(zip(images, row_titles, strict=True)):
        middle = (left - GAP_PX, top + step * i + (step - CAPTION_PX) / 2)
        draw.multiline_text(middle, title, TEXT_COLOUR, font, anchor="rm", align="right")
        for at, picture in zip(x, row, strict=False):
            page.paste(Image.fromarray(picture), (int(at), top + step * i))
    return np.asarray(page)


def save_png(picture: Picture, path: Path) -> None:
    """Write a picture in `PALETTE` colours; the same picture gives the same bytes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    reduced = Image.fromarray(picture).quantize(PALETTE, dither=Image.Dither.NONE)
    reduced.save(path, format="PNG", optimize=True)


def captioned(picture: Picture, caption: str, colour: Rgb = TEXT_COLOUR) -> Picture:
    """The picture with a line of text below it."""
    strip = Image.new("RGB", (picture.shape[1], CAPTION_PX), "white")
    at, font = (picture.shape[1] / 2, CAPTION_PX / 2), _font(CAPTION_FONT)
    ImageDraw.Draw(strip).text(at, caption, colour, font, anchor="mm")
    return np.concatenate([picture, np.asarray(strip)])


def message(text: str, size: tuple[int, int], caption: str = "") -> Picture:
    """A panel of ``size`` that says something instead of showing it."""
    page = Image.new("RGB", size, BACKGROUND)
    font = _font(TITLE_FONT)
    ImageDraw.Draw(page).text((size[0] / 2, size[1] / 2), text, TEXT_COLOUR, font, anchor="mm")
    return captioned(np.asarray(page), caption)


def framed(photograph: Picture, height: int, colour: Rgb) -> Picture:
    """The photograph at another height, with a border."""
    width = round(photograph.shape[1] * height / photograph.shape[0])
    out = cv2.resize(photograph, (width, height), interpolation=cv2.INTER_AREA)
    cv2.rectangle(out, (0, 0), (width - 1, height - 1), colour, FRAME_PX)
    return np.asarray(out, dtype=np.uint8)


def _font(size: int) -> ImageFont.FreeTypeFont:
    """DejaVu Sans, which comes with Matplotlib."""
    return ImageFont.truetype(Path(matplotlib.get_data_path(), "fonts/ttf/DejaVuSans.ttf"), size)


def _extent(text: str, font: ImageFont.FreeTypeFont) -> tuple[int, int]:
    """Width and height of a text of some lines, in pixels."""
    box = ImageDraw.Draw(Image.new("RGB", (1, 1))).multiline_textbbox((0, 0), text, font)
    return int(np.ceil(box[2])), int(np.ceil(box[3]))
