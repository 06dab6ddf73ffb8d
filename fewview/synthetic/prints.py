"""Procedural pictures: posters, photographs, spines, pages, screens, cupboard fronts, windows."""

from __future__ import annotations

import string

import numpy as np

from fewview.synthetic.textures import (
    Image,
    Rng,
    Texture,
    fractal,
    mixed,
    painted,
    pixels,
    shade,
    vivid,
)  # fmt: skip
from fewview.types import Array

_FONTS = (0, 2, 3, 4)  # OpenCV's Hershey fonts: simplex, duplex, complex, triplex
_LETTERS = np.array(list(string.ascii_letters + string.digits))
Size = tuple[float, float]


def _canvas(size_m: Size, texel: float, colour: Array) -> Image:
    height, width = (max(8, n) for n in pixels(size_m, texel))
    return np.full((height, width, 3), np.clip(colour, 0, 255), np.uint8)


def _px(metres: float, texel: float) -> int:
    return max(1, round(metres / texel))


def _word(rng: Rng, longest: int = 9) -> str:
    return "".join(_LETTERS[rng.integers(len(_LETTERS), size=rng.integers(2, longest))])


def _write(rng: Rng, image: Image, text: str, xy: tuple[int, int], height: int, ink: Array) -> None:
    import cv2

    font = _FONTS[rng.integers(len(_FONTS))]
    thickness = max(1, height // 9)
    cv2.putText(image, text, xy, font, height / 24.0, ink.tolist(), thickness, cv2.LINE_AA)


def _shape(rng: Rng, image: Image, ink: Array) -> None:
    import cv2

    height, width = image.shape[:2]
    x, y, kind = int(rng.integers(width)), int(rng.integers(height)), rng.integers(4)
    size = int(rng.uniform(0.05, 0.3) * min(height, width))
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


def photo(rng: Rng, size_m: Size, texel_m: float = 0.0025) -> Texture:
    """A landscape-like picture: clouded sky, ridges, blobs in front."""
    return painted(rng, size_m, texel_m, lambda rng, texel: _photo(rng, size_m, texel))


def _photo(rng: Rng, size_m: Size, texel: float) -> Image:
    import cv2

    image = _canvas(size_m, texel, np.zeros(3))
    height, width = image.shape[:2]
    sky, levels = vivid(rng), np.sort(rng.uniform(0.25, 0.95, rng.integers(2, 5)))
    clouds = fractal(rng, (height, width), width / 3, 4)
    image[:] = mixed(sky, np.full(3, 235.0), 0.5 + 0.4 * clouds)
    x = np.arange(width)
    for level in levels:
        ridge = height * level + 0.1 * height * fractal(rng, (2, width), width / 3, 5)[0]
        line = np.stack([x, ridge], axis=-1).astype(np.int32)
        outline = np.concatenate([line, [[width, height], [0, height]]]).astype(np.int32)
        cv2.fillPoly(image, [outline], vivid(rng).tolist(), cv2.LINE_AA)
    for _ in range(rng.integers(0, 9)):
        _shape(rng, image, vivid(rng))
    grain = fractal(rng, (height, width), 0.02 / texel, 3)
    return shade(image.astype(np.float32), 0.1 * grain)


def poster(rng: Rng, size_m: Size, texel_m: float = 0.0025) -> Texture:
    """A plain or graphic ground with shapes, a headline and small print."""
    return painted(rng, size_m, texel_m, lambda rng, texel: _poster(rng, size_m, texel))


def _poster(rng: Rng, size_m: Size, texel: float) -> Image:
    image = _canvas(size_m, texel, vivid(rng) if rng.uniform() < 0.6 else np.full(3, 235.0))
    height, width = image.shape[:2]
    inks = [vivid(rng) for _ in range(3)] + [np.full(3, 20.0), np.full(3, 245.0)]
    for _ in range(rng.integers(3, 14)):
        _shape(rng, image, inks[rng.integers(len(inks))])
    for _ in range(rng.integers(1, 5)):
        spot = int(rng.uniform(0, 0.4) * width), int(rng.uniform(0.1, 0.95) * height)
        size = int(rng.uniform(0.05, 0.16) * min(height, width)) + _px(0.01, texel)
        _write(rng, image, _word(rng), spot, size, inks[rng.integers(len(inks))])
    return image


def spines(rng: Rng, widths: Array, height_m: float, texel_m: float = 0.0025) -> Texture:
    """The backs of a row of standing books: grounds, bands, titles from top to bottom.

    Args:
        rng: source of chance.
        widths: (n,) metres, from left to right.
        height_m: of the tallest.
        texel_m: edge of a pixel at full detail.
    """
    edges = np.append(0, np.cumsum(widths))

    def image(rng: Rng, texel: float) -> Image:
        row = _canvas((float(edges[-1]), height_m), texel, np.full(3, 90.0))
        bounds = np.rint(edges * (row.shape[1] / edges[-1])).astype(int)
        for left, right in zip(bounds[:-1], bounds[1:], strict=True):
            if right > left:
                row[:, left:right] = _spine(rng, right - left, row.shape[0], texel)
        return row

    return painted(rng, (float(edges[-1]), height_m), texel_m, image)


def _spine(rng: Rng, thickness: int, length: int, texel: float) -> Image:
    ground = vivid(rng) if rng.uniform() < 0.7 else np.full(3, rng.uniform(20, 240))
    lying = np.full((thickness, length, 3), ground, np.uint8)
    ink = vivid(rng) if ground.mean() > 110 else np.full(3, 225.0)
    for at in rng.uniform(0, 1, rng.integers(0, 4)):
        left = int(at * length)
        lying[:, left : left + _px(rng.uniform(0.002, 0.014), texel)] = ink
    if thickness > 4:
        start = int(rng.uniform(0.05, 0.35) * length)
        size = int(0.7 * thickness)
        _write(rng, lying, _word(rng, 12), (start, int(0.75 * thickness)), size, ink)
    return np.asarray(np.rot90(lying, -1))


def page(rng: Rng, size_m: Size, texel_m: float = 0.0025) -> Texture:
    """A sheet of paper with lines of text and perhaps a picture."""

    def image(rng: Rng, texel: float) -> Image:
        sheet = _canvas(size_m, texel, np.full(3, rng.uniform(215, 250)))
        height, width = sheet.shape[:2]
        ink, pictured = np.full(3, rng.uniform(20, 90)), rng.uniform() < 0.6
        pitch, edge = max(2, _px(0.0125, texel)), _px(0.01, texel)
        for y in range(2 * edge, height - edge, pitch):
            x = edge
            while x < width - 2 * edge and rng.uniform() > 0.08:
                end = x + _px(rng.uniform(0.0075, 0.035), texel)
                sheet[y : y + _px(0.005, texel), x : min(end, width - edge)] = ink
                x = end + _px(0.0075, texel)
        if pictured:
            _picture(rng, sheet, 0.5, texel)
        return sheet

    return painted(rng, size_m, texel_m, image, np.full(3, 235.0))


def _picture(rng: Rng, image: Image, share: float, texel: float) -> None:
    import cv2

    height, width = (max(2, int(share * n)) for n in image.shape[:2])
    x, y = int(rng.integers(image.shape[1] - width)), int(rng.integers(image.shape[0] - height))
    inset = _photo(rng, (width * texel, height * texel), texel)
    image[y : y + height, x : x + width] = cv2.resize(inset, (width, height))


def screen(rng: Rng, size_m: Size, texel_m: float = 0.0025) -> Texture:
    """A monitor or television in its bezel, switched off or showing windows."""

    def image(rng: Rng, texel: float) -> Image:
        import cv2

        panel = _canvas(size_m, texel, np.full(3, 25.0))
        if rng.uniform() < 0.7:
            content = (_photo if rng.uniform() < 0.5 else _poster)(rng, size_m, texel)
            edge = _px(0.015, texel)
            inside = panel[edge:-edge, edge:-edge]
            inside[:] = cv2.resize(content, (inside.shape[1], inside.shape[0]))
            for _ in range(rng.integers(0, 3)):
                _picture(rng, inside, rng.uniform(0.2, 0.5), texel)
        return panel

    return painted(rng, size_m, texel_m, image, np.full(3, 40.0))


def front(rng: Rng, size_m: Size, colour: Array, columns: int, rows: int) -> Texture:
    """Doors and drawers: gaps between them, frames on some, handles."""

    def image(rng: Rng, texel: float) -> Image:
        import cv2

        face = _canvas(size_m, texel, colour)
        height, width = face.shape[:2]
        framed, upright = rng.uniform() < 0.5, rng.uniform() < 0.5
        metal = np.full(3, rng.uniform(60, 220)).tolist()
        grain = fractal(rng, (height, width), 0.16 / texel, 4, stretch=3.0)
        face[:] = shade(colour, 0.03 * grain)
        line, rim, reach = (_px(m, texel) for m in (0.008, 0.048, 0.056))
        long, thick = _px(0.108, texel), _px(0.016, texel)
        for column in range(columns):
            for row in range(rows):
                x0, x1 = (int(c * (width - 1) / columns) for c in (column, column + 1))
                y0, y1 = (int(r * (height - 1) / rows) for r in (row, row + 1))
                cv2.rectangle(face, (x0, y0), (x1, y1), (colour * 0.35).tolist(), line)
                if framed:
                    inner = (x0 + rim, y0 + rim), (x1 - rim, y1 - rim)
                    cv2.rectangle(face, *inner, (colour * 0.75).tolist(), line)
                middle = (x0 + x1) // 2, (y0 + y1) // 2
                hand = (x1 - reach, middle[1] - long // 2)
                far = hand[0] + thick, hand[1] + long
                if not upright:
                    hand = (middle[0] - long // 2, y0 + reach)
                    far = hand[0] + long, hand[1] + thick
                cv2.rectangle(face, hand, far, metal, -1)
        return face

    return painted(rng, size_m, 0.004, image, colour)


def outside(rng: Rng, size_m: Size) -> Texture:
    """What a window shows: a bright, blurred view behind white bars."""

    def image(rng: Rng, texel: float) -> Image:
        import cv2

        bars = int(rng.integers(1, 4))
        view = cv2.GaussianBlur(_photo(rng, size_m, texel), (0, 0), max(0.4, 0.009 / texel))
        bright = cv2.addWeighted(view, 0.5, np.full_like(view, 255), 0.5, 20)
        height, width = bright.shape[:2]
        for bar in range(bars + 1):
            x = int(bar * (width - 1) / bars)
            cv2.line(bright, (x, 0), (x, height), (225, 225, 220), _px(0.07, texel))
        corner = (width - 1, height - 1)
        cv2.rectangle(bright, (0, 0), corner, (225, 225, 220), _px(0.085, texel))
        return np.asarray(bright)

    return painted(rng, size_m, 0.006, image)


def whiteboard(rng: Rng, size_m: Size, texel_m: float = 0.003) -> Texture:
    """A board with hand-drawn lines, boxes and words."""

    def image(rng: Rng, texel: float) -> Image:
        import cv2

        board = _canvas(size_m, texel, np.full(3, 232.0))
        height, width = board.shape[:2]
        for _ in range(rng.integers(4, 16)):
            ink = vivid(rng) * 0.7
            if rng.uniform() < 0.5:
                spot = int(rng.uniform(0, 0.8) * width), int(rng.uniform(0.1, 0.95) * height)
                _write(rng, board, _word(rng), spot, _px(rng.uniform(0.027, 0.078), texel), ink)
            else:
                start = np.array([rng.uniform(0, width), rng.uniform(0, height)])
                steps = rng.normal(0, 0.042 / texel, (rng.integers(3, 12), 2))
                stroke = (start + np.cumsum(steps, axis=0)).astype(np.int32)
                thick = _px(0.006, texel)
                cv2.polylines(board, [stroke], False, ink.tolist(), thick, cv2.LINE_AA)
        corner = (width - 1, height - 1)
        cv2.rectangle(board, (0, 0), corner, (150, 150, 155), _px(0.024, texel))
        return board

    return painted(rng, size_m, texel_m, image, np.full(3, 230.0))
