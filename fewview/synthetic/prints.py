"""Procedural pictures: posters, photographs, spines, pages, screens, cupboard fronts, windows."""

from __future__ import annotations

import string

import cv2
import numpy as np

from fewview.synthetic.textures import Image, Rng, Texture, fractal, mixed, shade, vivid
from fewview.types import Array

_FONTS = (
    cv2.FONT_HERSHEY_SIMPLEX,
    cv2.FONT_HERSHEY_DUPLEX,
    cv2.FONT_HERSHEY_TRIPLEX,
    cv2.FONT_HERSHEY_COMPLEX,
)


def _canvas(size_m: tuple[float, float], texel_m: float, colour: Array) -> Image:
    height, width = (max(8, round(s / texel_m)) for s in (size_m[1], size_m[0]))
    return np.full((height, width, 3), np.clip(colour, 0, 255), np.uint8)


def _word(rng: Rng, longest: int = 9) -> str:
    letters = rng.choice(list(string.ascii_letters + string.digits), rng.integers(2, longest))
    return "".join(letters)


def _write(rng: Rng, image: Image, text: str, xy: tuple[int, int], height: int, ink: Array) -> None:
    font = _FONTS[rng.integers(len(_FONTS))]
    thickness = max(1, height // 9)
    cv2.putText(image, text, xy, font, height / 24.0, ink.tolist(), thickness, cv2.LINE_AA)


def _shape(rng: Rng, image: Image, ink: Array) -> None:
    height, width = image.shape[:2]
    x, y = int(rng.integers(width)), int(rng.integers(height))
    size = int(rng.uniform(0.05, 0.3) * min(height, width))
    kind = rng.integers(4)
    thickness = -1 if rng.uniform() < 0.7 else max(1, size // 5)
    if kind == 0:
        cv2.circle(image, (x, y), size, ink.tolist(), thickness, cv2.LINE_AA)
    elif kind == 1:
        far = (x + int(rng.integers(-2 * size, 2 * size + 1)), y + size)
        cv2.rectangle(image, (x, y), far, ink.tolist(), thickness)
    elif kind == 2:
        corners = np.array([x, y]) + rng.integers(-size, size + 1, (rng.integers(3, 7), 2))
        cv2.fillPoly(image, [corners.astype(np.int32)], ink.tolist(), cv2.LINE_AA)
    else:
        far = (x + int(rng.integers(-3 * size, 3 * size + 1)), y + int(rng.integers(3 * size + 1)))
        cv2.line(image, (x, y), far, ink.tolist(), max(1, size // 6), cv2.LINE_AA)


def photo(rng: Rng, size_m: tuple[float, float], texel_m: float = 0.0025) -> Texture:
    """A landscape-like picture: clouded sky, ridges, blobs in front."""
    image = _canvas(size_m, texel_m, np.zeros(3))
    height, width = image.shape[:2]
    clouds = fractal(rng, (height, width), width / 3, 4)
    image[:] = mixed(vivid(rng), np.full(3, 235.0), 0.5 + 0.4 * clouds)
    x = np.arange(width)
    for level in np.sort(rng.uniform(0.25, 0.95, rng.integers(2, 5))):
        ridge = height * level + 0.1 * height * fractal(rng, (2, width), width / 3, 5)[0]
        line = np.stack([x, ridge], axis=-1).astype(np.int32)
        outline = np.concatenate([line, [[width, height], [0, height]]]).astype(np.int32)
        cv2.fillPoly(image, [outline], vivid(rng).tolist(), cv2.LINE_AA)
    for _ in range(rng.integers(0, 9)):
        _shape(rng, image, vivid(rng))
    return Texture(
        shade(image.astype(np.float32), 0.1 * fractal(rng, (height, width), 8, 3)), texel_m
    )


def poster(rng: Rng, size_m: tuple[float, float], texel_m: float = 0.0025) -> Texture:
    """A plain or graphic ground with shapes, a headline and small print."""
    image = _canvas(size_m, texel_m, vivid(rng) if rng.uniform() < 0.6 else np.full(3, 235.0))
    height, width = image.shape[:2]
    inks = [vivid(rng) for _ in range(3)] + [np.full(3, 20.0), np.full(3, 245.0)]
    for _ in range(rng.integers(3, 14)):
        _shape(rng, image, inks[rng.integers(len(inks))])
    for _ in range(rng.integers(1, 5)):
        spot = int(rng.uniform(0, 0.4) * width), int(rng.uniform(0.1, 0.95) * height)
        size = int(rng.uniform(0.05, 0.16) * min(height, width)) + 4
        _write(rng, image, _word(rng), spot, size, inks[rng.integers(len(inks))])
    return Texture(image, texel_m)


def spine(rng: Rng, size_m: tuple[float, float], texel_m: float = 0.0025) -> Texture:
    """The back of a standing book: ground, bands, a title from top to bottom."""
    ground = vivid(rng) if rng.uniform() < 0.7 else np.full(3, rng.uniform(20, 240))
    image = _canvas((size_m[1], size_m[0]), texel_m, ground)
    thickness, length = image.shape[:2]
    ink = vivid(rng) if ground.mean() > 110 else np.full(3, 225.0)
    for at in rng.uniform(0, 1, rng.integers(0, 4)):
        left = int(at * length)
        image[:, left : left + int(rng.integers(1, 6))] = ink
    start = int(rng.uniform(0.05, 0.35) * length)
    _write(rng, image, _word(rng, 12), (start, int(0.75 * thickness)), int(0.7 * thickness), ink)
    return Texture(np.ascontiguousarray(np.rot90(image, -1)), texel_m)


def page(rng: Rng, size_m: tuple[float, float], texel_m: float = 0.0025) -> Texture:
    """A sheet of paper with lines of text and perhaps a picture."""
    image = _canvas(size_m, texel_m, np.full(3, rng.uniform(215, 250)))
    height, width = image.shape[:2]
    ink = np.full(3, rng.uniform(20, 90))
    for y in range(8, height - 3, 5):
        x = 4
        while x < width - 8 and rng.uniform() > 0.08:
            end = x + int(rng.integers(3, 14))
            image[y : y + 2, x : min(end, width - 5)] = ink
            x = end + 3
    if rng.uniform() < 0.6:
        _picture(rng, image, 0.5)
    return Texture(image, texel_m)


def _picture(rng: Rng, image: Image, share: float) -> None:
    height, width = (int(share * n) for n in image.shape[:2])
    x, y = int(rng.integers(image.shape[1] - width)), int(rng.integers(image.shape[0] - height))
    inset = photo(rng, (width * 2.5e-3, height * 2.5e-3)).image
    image[y : y + height, x : x + width] = cv2.resize(inset, (width, height))


def screen(rng: Rng, size_m: tuple[float, float], texel_m: float = 0.0025) -> Texture:
    """A monitor or television in its bezel, switched off or showing windows."""
    image = _canvas(size_m, texel_m, np.full(3, 25.0))
    if rng.uniform() < 0.7:
        content = photo(rng, size_m).image if rng.uniform() < 0.5 else poster(rng, size_m).image
        inside = image[6:-6, 6:-6]
        inside[:] = cv2.resize(content, (inside.shape[1], inside.shape[0]))
        for _ in range(rng.integers(0, 3)):
            _picture(rng, inside, rng.uniform(0.2, 0.5))
    return Texture(image, texel_m)


def front(rng: Rng, size_m: tuple[float, float], colour: Array, columns: int, rows: int) -> Texture:
    """Doors and drawers: gaps between them, frames on some, handles."""
    texel_m = 0.004
    image = _canvas(size_m, texel_m, colour)
    height, width = image.shape[:2]
    image[:] = shade(colour, 0.03 * fractal(rng, (height, width), 40, 4, stretch=3.0))
    framed, upright = rng.uniform() < 0.5, rng.uniform() < 0.5
    metal = np.full(3, rng.uniform(60, 220)).tolist()
    for column in range(columns):
        for row in range(rows):
            x0, x1 = (int(c * (width - 1) / columns) for c in (column, column + 1))
            y0, y1 = (int(r * (height - 1) / rows) for r in (row, row + 1))
            cv2.rectangle(image, (x0, y0), (x1, y1), (colour * 0.35).tolist(), 2)
            if framed:
                inner = (x0 + 12, y0 + 12), (x1 - 12, y1 - 12)
                cv2.rectangle(image, *inner, (colour * 0.75).tolist(), 2)
            hand = (x1 - 14, (y0 + y1) // 2 - 12) if upright else ((x0 + x1) // 2 - 14, y0 + 16)
            far = (hand[0] + 4, hand[1] + 26) if upright else (hand[0] + 28, hand[1] + 4)
            cv2.rectangle(image, hand, far, metal, -1)
    return Texture(image, texel_m)


def outside(rng: Rng, size_m: tuple[float, float]) -> Texture:
    """What a window shows: a bright, blurred view behind white bars."""
    view = photo(rng, size_m, 0.006).image
    bright = cv2.addWeighted(
        cv2.GaussianBlur(view, (0, 0), 1.5), 0.5, np.full_like(view, 255), 0.5, 20
    )
    height, width = bright.shape[:2]
    bars = int(rng.integers(1, 4))
    for bar in range(bars + 1):
        x = int(bar * (width - 1) / bars)
        cv2.line(bright, (x, 0), (x, height), (225, 225, 220), 12)
    cv2.rectangle(bright, (0, 0), (width - 1, height - 1), (225, 225, 220), 14)
    return Texture(bright, 0.006)


def whiteboard(rng: Rng, size_m: tuple[float, float], texel_m: float = 0.003) -> Texture:
    """A board with hand-drawn lines, boxes and words."""
    image = _canvas(size_m, texel_m, np.full(3, 232.0))
    height, width = image.shape[:2]
    for _ in range(rng.integers(4, 16)):
        ink = vivid(rng) * 0.7
        if rng.uniform() < 0.5:
            spot = int(rng.uniform(0, 0.8) * width), int(rng.uniform(0.1, 0.95) * height)
            _write(rng, image, _word(rng), spot, int(rng.integers(9, 26)), ink)
        else:
            start = np.array([rng.uniform(0, width), rng.uniform(0, height)])
            stroke = start + np.cumsum(rng.normal(0, 14, (rng.integers(3, 12), 2)), axis=0)
            cv2.polylines(image, [stroke.astype(np.int32)], False, ink.tolist(), 2, cv2.LINE_AA)
    cv2.rectangle(image, (0, 0), (width - 1, height - 1), (150, 150, 155), 8)
    return Texture(image, texel_m)
