"""Procedural materials: paint, wood, fabric, tiles and the like as small colour images."""

from __future__ import annotations

import colorsys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fewview.types import Array, BoolArray, FloatArray

Rng = np.random.Generator
Image = NDArray[np.uint8]
_TONES = np.random.default_rng(0).uniform(50, 220, (64, 3))


@dataclass(frozen=True, eq=False)
class Texture:
    """A colour image that is laid on surfaces, painted when it is asked for.

    Attributes:
        size: (width, height) in pixels at full detail.
        texel_m: edge of one of these pixels on the surface, metres.
        painter: from the edge of a pixel, metres, to the (h, w, 3) uint8 RGB image.
        tone: (3,) about the mean colour, 0..255.
    """

    size: tuple[int, int]
    texel_m: float
    painter: Callable[[float], Image]
    tone: Array

    def image(self, coarser: float = 1.0) -> Image:
        """The image with pixels ``coarser`` times as large as at full detail."""
        return self.painter(coarser * self.texel_m)


def painted(
    rng: Rng,
    size_m: tuple[float, float],
    texel_m: float,
    paint: Callable[[Rng, float], Image],
    tone: Array | None = None,
) -> Texture:
    """A texture whose painter has a source of chance of its own, seeded from ``rng``."""
    seed = int(rng.integers(2**63))
    height, width = pixels(size_m, texel_m)
    return Texture(
        size=(width, height),
        texel_m=texel_m,
        painter=lambda texel: paint(np.random.default_rng(seed), texel),
        tone=_TONES[seed % len(_TONES)] if tone is None else tone,
    )


def colour(rng: Rng, saturation: tuple[float, float], value: tuple[float, float]) -> Array:
    """A random RGB colour (3,) in 0..255 of any hue."""
    hsv = rng.uniform(), rng.uniform(*saturation), rng.uniform(*value)
    return 255.0 * np.array(colorsys.hsv_to_rgb(*hsv))


def muted(rng: Rng) -> Array:
    """A colour of furniture and walls."""
    return colour(rng, (0.03, 0.35), (0.3, 0.85))


def vivid(rng: Rng) -> Array:
    """A colour of print, books and toys."""
    return colour(rng, (0.25, 0.85), (0.2, 0.95))


def brown(rng: Rng) -> Array:
    """A colour of wood, from ebony to maple."""
    return np.array([205.0, 150.0, 95.0]) * rng.uniform(0.35, 1.15) + rng.uniform(-14, 14, 3)


def fractal(
    rng: Rng, shape: tuple[int, int], cell: float, octaves: int = 4, stretch: float = 1.0
) -> FloatArray:
    """Multi-octave value noise of mean 0 and deviation about 1.

    Args:
        rng: source of the noise.
        shape: (h, w) of the result.
        cell: pixels between the grid points of the coarsest octave; halves with each octave.
        octaves: number of octaves, amplitudes falling by 0.65.
        stretch: how much longer the features are along x than along y.
    """
    import cv2

    height, width = shape
    out = np.zeros(shape, np.float32)
    for octave in range(octaves):
        step = max(cell / 2**octave, 1.0)
        grid = (2 + int(height / step), 2 + int(width / (step * stretch)))
        noise = rng.standard_normal(grid, dtype=np.float32)
        method = cv2.INTER_CUBIC if octave == 0 else cv2.INTER_LINEAR
        noise *= np.float32(0.65**octave)
        out += cv2.resize(noise, (width, height), interpolation=method)
    return out


def shade(base: Array | FloatArray, field: FloatArray) -> Image:
    """A colour (3,) or image (h, w, 3) times one plus ``field`` (h, w)."""
    gain = np.asarray(field, np.float32) + np.float32(1)
    lit = np.asarray(base, np.float32) * gain[..., None]
    return np.clip(lit, 0, 255, out=lit).astype(np.uint8)


def mixed(first: Array, second: Array, weight: FloatArray) -> FloatArray:
    """(h, w, 3) blend of two colours; ``weight`` (h, w) in 0..1 is the share of the second."""
    start, step = np.float32(first), np.float32(second - first)
    return np.asarray(start + step * np.clip(weight, 0, 1, dtype=np.float32)[..., None])


def pixels(size_m: tuple[float, float], texel_m: float) -> tuple[int, int]:
    """(h, w) of an image of a (width, height) in metres."""
    return max(4, round(size_m[1] / texel_m)), max(4, round(size_m[0] / texel_m))


def plain(rng: Rng, base: Array) -> Texture:
    """Plastic, china, metal or lacquer: nearly uniform."""

    def image(rng: Rng, texel: float) -> Image:
        shape = pixels((0.288, 0.288), texel)
        return shade(base, np.float32(0.012) * rng.standard_normal(shape, dtype=np.float32))

    return painted(rng, (0.288, 0.288), 0.012, image, base)


def laid(
    rng: Rng, shape: tuple[int, int], unit: tuple[float, float], shifted: bool, joint: float
) -> tuple[FloatArray, NDArray[np.int32], BoolArray]:
    """Rectangular units in rows: tiles, bricks, planks.

    Args:
        rng: source of shades and shifts.
        shape: (h, w) of the result.
        unit: (width, height) of a unit in pixels.
        shifted: rows begin at random places, else units are aligned.
        joint: width of the joints, pixels.

    Returns:
        A standard-normal shade per unit, the unit's number, and a mask of the joints; all (h, w).
    """
    y, x = np.arange(shape[0]), np.arange(shape[1], dtype=np.float32)
    row = (y // unit[1]).astype(np.int32)
    shifts = rng.uniform(0, unit[0], row[-1] + 1) if shifted else np.zeros(row[-1] + 1)
    along = (x[None] + shifts.astype(np.float32)[row][:, None]) / np.float32(unit[0])
    column = along.astype(np.int32)
    joints = (along - column < joint / unit[0]) | (y % unit[1] < joint)[:, None]
    columns = int(column.max()) + 1
    number = row[:, None] * np.int32(columns) + column
    shades = rng.standard_normal((row[-1] + 1) * columns, dtype=np.float32)
    return shades[number], number, joints


def paint(rng: Rng, size_m: tuple[float, float], base: Array, texel_m: float = 0.008) -> Texture:
    """Painted plaster: almost plain, with a faint unevenness and a few scuffs."""

    def image(rng: Rng, texel: float) -> Image:
        shape = pixels(size_m, texel)
        field = 0.012 * fractal(rng, shape, 1.0 / texel, 3) + 0.008 * fractal(rng, shape, 4, 2)
        scuffs = fractal(rng, shape, 0.12 / texel, 3)
        field -= 0.1 * np.clip(scuffs - 2.9, 0, 1)
        return shade(base, field)

    return painted(rng, size_m, texel_m, image, base)


def wood(rng: Rng, size_m: tuple[float, float], base: Array, texel_m: float = 0.004) -> Texture:
    """Boards with grain along x."""

    def image(rng: Rng, texel: float) -> Image:
        shape = pixels(size_m, texel)
        swirl, board = np.float32(rng.uniform(3, 7)), rng.uniform(0.12, 0.3) / texel
        warp = fractal(rng, shape, 0.12 / texel, 3, stretch=5.0)
        rows = np.arange(shape[0], dtype=np.float32)[:, None] * np.float32(60 * texel)
        lines = np.sin(warp * swirl + rows)
        fine = fractal(rng, shape, 3, 2, stretch=12.0)
        shades, _, joints = laid(rng, shape, (9e9, board), False, 1)
        field = 0.07 * lines + 0.05 * fine + 0.06 * shades - np.float32(0.25) * joints
        return shade(base, field)

    return painted(rng, size_m, texel_m, image, base)


def fabric(rng: Rng, size_m: tuple[float, float], base: Array, texel_m: float = 0.004) -> Texture:
    """Upholstery and blankets: woven, plain, striped, checked or blotched with a second colour."""

    def image(rng: Rng, texel: float) -> Image:
        shape = pixels(size_m, texel)
        kind, second, period = rng.integers(4), muted(rng), rng.uniform(0.05, 0.16) / texel
        pattern = np.zeros(shape, np.float32)
        if kind in (1, 2):
            wobble = fractal(rng, shape, 30, 2)
            for axis in np.indices(shape, dtype=np.float32)[:kind]:
                stripes = np.sin(np.float32(2 * np.pi / period) * (axis + wobble)) > 0.3
                pattern += stripes / np.float32(kind)
        elif kind == 3:
            pattern += fractal(rng, shape, 0.15 / texel, 3) > 0.4
        body = mixed(base, second, 0.7 * pattern)
        field = 0.07 * fractal(rng, shape, 0.25 / texel, 2) + 0.06 * fractal(rng, shape, 2, 1)
        return shade(body, field)

    return painted(rng, size_m, texel_m, image, base)


def stone(rng: Rng, size_m: tuple[float, float], base: Array, texel_m: float = 0.004) -> Texture:
    """Speckled counter tops and pots."""

    def image(rng: Rng, texel: float) -> Image:
        shape = pixels(size_m, texel)
        field = 0.1 * fractal(rng, shape, 3, 2) + 0.06 * fractal(rng, shape, 0.3 / texel, 3)
        return shade(base, field)

    return painted(rng, size_m, texel_m, image, base)


def tiles(rng: Rng, size_m: tuple[float, float], base: Array, texel_m: float = 0.005) -> Texture:
    """Square tiles of slightly different shade with joints."""

    def image(rng: Rng, texel: float) -> Image:
        shape = pixels(size_m, texel)
        edge = rng.choice([0.1, 0.2, 0.3, 0.45]) / texel
        gap = np.float32(rng.uniform(0.15, 0.4))
        shades, _, joints = laid(rng, shape, (edge, edge), False, max(1.0, 0.006 / texel))
        marble = fractal(rng, shape, 0.25 / texel, 4)
        field = 0.05 * shades + 0.05 * marble - gap * joints
        return shade(base, field)

    return painted(rng, size_m, texel_m, image, base)


def brick(rng: Rng, size_m: tuple[float, float], base: Array, texel_m: float = 0.006) -> Texture:
    """A wall of bare brick."""

    def image(rng: Rng, texel: float) -> Image:
        shape = pixels(size_m, texel)
        unit = (0.24 / texel, 0.08 / texel)
        shades, _, joints = laid(rng, shape, unit, True, 0.012 / texel)
        body = np.where(joints[..., None], 175.0, np.asarray(base)).astype(np.float32)
        field = 0.13 * shades * ~joints + 0.08 * fractal(rng, shape, 12, 3)
        return shade(body, field)

    return painted(rng, size_m, texel_m, image, base)


def parquet(rng: Rng, size_m: tuple[float, float], base: Array, texel_m: float = 0.006) -> Texture:
    """A floor of planks, each with its own shade and grain."""

    def image(rng: Rng, texel: float) -> Image:
        shape = pixels(size_m, texel)
        unit = (rng.uniform(0.6, 1.6) / texel, rng.uniform(0.08, 0.2) / texel)
        shades, number, joints = laid(rng, shape, unit, True, 1)
        grain = fractal(rng, shape, 4, 2, stretch=15.0)
        rings = np.sin(
            2.5 * fractal(rng, shape, 0.15 / texel, 2, stretch=4.0) + number.astype(np.float32)
        )
        field = 0.1 * shades + 0.05 * grain + 0.05 * rings - np.float32(0.35) * joints
        return shade(base, field)

    return painted(rng, size_m, texel_m, image, base)


def carpet(rng: Rng, size_m: tuple[float, float], base: Array, texel_m: float = 0.006) -> Texture:
    """A woven floor covering: mottled, or lines of changing shade in squares."""

    def image(rng: Rng, texel: float) -> Image:
        shape = pixels(size_m, texel)
        lined = rng.uniform() < 0.5
        pile = 0.1 * fractal(rng, shape, 3, 2) + 0.05 * fractal(rng, shape, 0.5 / texel, 3)
        if not lined:
            return shade(base, pile)
        lines, _, _ = laid(rng, shape, (rng.uniform(0.2, 1.2) / texel, 2), True, 0)
        return shade(base, pile + np.float32(0.16) * lines)

    return painted(rng, size_m, texel_m, image, base)


def rug(rng: Rng, size_m: tuple[float, float], base: Array, texel_m: float = 0.005) -> Texture:
    """A patterned rug: border, checks of irregular sizes, medallions."""

    def image(rng: Rng, texel: float) -> Image:
        import cv2

        shape = pixels(size_m, texel)
        image = np.full((*shape, 3), base, np.float32)
        xs = np.cumsum(rng.uniform(0.08, 0.3, 40) / texel).astype(int)
        ys = np.cumsum(rng.uniform(0.08, 0.3, 40) / texel).astype(int)
        palette = [muted(rng) for _ in range(4)]
        for x, y in rng.integers(0, 39, (160, 2)):
            corner = (int(xs[x]), int(ys[y])), (int(xs[x + 1]), int(ys[y + 1]))
            cv2.rectangle(image, *corner, palette[(x + y) % 4].tolist(), -1)
        for x, y in rng.uniform(0.1, 0.9, (8, 2)):
            centre = (int(x * shape[1]), int(y * shape[0]))
            radius = int(rng.uniform(0.03, 0.12) / texel)
            cv2.circle(image, centre, radius, palette[radius % 4].tolist(), int(rng.integers(2, 9)))
        border = int(0.06 / texel)
        cv2.rectangle(image, (0, 0), (shape[1] - 1, shape[0] - 1), palette[0].tolist(), border)
        return shade(image, 0.09 * fractal(rng, shape, 4, 2))

    return painted(rng, size_m, texel_m, image, base)


def wallpaper(
    rng: Rng, size_m: tuple[float, float], base: Array, texel_m: float = 0.006
) -> Texture:
    """Paper with loosely scattered motifs, or stripes of changing width, in a near colour."""

    def image(rng: Rng, texel: float) -> Image:
        import cv2

        shape = pixels(size_m, texel)
        image = np.full((*shape, 3), base, np.float32)
        tint = (base * rng.uniform(0.7, 0.9)).tolist()
        if rng.uniform() < 0.5:
            edges = np.cumsum(rng.uniform(0.05, 0.2, 200) / texel).astype(int)
            for left, right in edges.reshape(-1, 2):
                image[:, left:right] = tint
        else:
            for _ in range(int(14 * size_m[0] * size_m[1])):
                centre = (int(rng.integers(shape[1])), int(rng.integers(shape[0])))
                axes = (int(rng.uniform(0.01, 0.04) / texel), int(rng.uniform(0.02, 0.06) / texel))
                cv2.ellipse(image, centre, axes, rng.uniform(0, 180), 0, 360, tint, -1)
        return shade(image, 0.012 * fractal(rng, shape, 100, 4))

    return painted(rng, size_m, texel_m, image, base)
