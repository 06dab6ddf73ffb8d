"""The shape of a library's model: upright, of its true size, with few quadrilaterals."""

from __future__ import annotations

import posixpath
import zipfile
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from fewview.synthetic.simplify import area, paired, simplified, single
from fewview.synthetic.wavefront import Material, Wavefront, read_mtl, read_obj
from fewview.types import Array, FloatArray, IntArray

BUDGET = 400
"""Triangles of a model, about."""
_MOST = 1.3
_LEAST_AREA = 0.7
_SOLID = 0.4
_TOP_M = 0.04
_GRID = 24
_OUR_AXES = np.array([[-1.0, 0, 0], [0, 0, 1], [0, 1, 0]])


@dataclass(frozen=True, eq=False)
class Shape:
    """A thing on z = 0, centred on its footprint, its front towards +y.

    Attributes:
        size: (3,) width, depth and height, metres.
        corners: (n, 4, 3) quadrilaterals; a triangle's last corner is there twice.
        material: (n,) index into ``colours``.
        colours: (m, 3) RGB, 0..255.
        top: share of the footprint at the height of the top.
    """

    size: Array
    corners: Array
    material: IntArray
    colours: Array
    top: float


def load_shape(archive: Path, member: str, turn: Array, size: Array) -> Shape | None:
    """Read a model out of a catalogue, None where it does not make a usable shape.

    Args:
        archive: the catalogue, a zip file.
        member: name of the OBJ file inside.
        turn: (3, 3) rotation that makes it upright with y up and its front towards z.
        size: (3,) width, depth and height, metres.
    """
    with zipfile.ZipFile(archive) as files:
        try:
            model = read_obj(_text(files, member))
        except (KeyError, ValueError):
            return None
        if not len(model.triangles):
            return None
        looks = _looks(files, member, model)
        colours = np.array([_colour(files, member, look) for look in looks]).reshape(-1, 3)
    triangles = _placed(model, turn, size)
    solid = np.array([look.opacity > _SOLID for look in looks])[model.material]
    return _shape(triangles[solid], model.material[solid], colours, size)


def _shape(triangles: Array, material: IntArray, colours: Array, size: Array) -> Shape | None:
    triangles, material = single(triangles, material)
    few, of_few = simplified(triangles, material, BUDGET)
    if not len(few) or len(few) > _MOST * BUDGET or area(few) < _LEAST_AREA * area(triangles):
        return None
    corners, of_quad = paired(few, of_few)
    return Shape(size, corners, of_quad, colours, _top_share(few, size))


def _placed(model: Wavefront, turn: Array, size: Array) -> Array:
    """(n, 3, 3) corners of the triangles in the frame of `Shape`."""
    points = model.vertices[model.triangles] @ (_OUR_AXES @ turn).T
    low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
    scale = size / np.maximum(high - low, 1e-9)
    return np.asarray((points - low) * scale - size * [0.5, 0.5, 0.0])


def _top_share(triangles: Array, size: Array) -> float:
    """Share of a grid on the footprint that is covered near the greatest height."""
    high = triangles[..., 2] > size[2] - _TOP_M
    flat = triangles[high.all(axis=1), :, :2]
    steps = (np.arange(_GRID) + 0.5) / _GRID - 0.5
    spots = np.stack(np.meshgrid(steps * size[0], steps * size[1]), axis=-1).reshape(-1, 1, 2)
    ahead = np.roll(flat, -1, axis=1) - flat
    sides = [_cross(ahead[:, k], spots - flat[:, k]) for k in range(3)]
    least, most = np.min(sides, axis=0), np.max(sides, axis=0)
    inside = (least >= 0) | (most <= 0)
    return float(np.mean(np.any(inside, axis=1)))


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _looks(files: zipfile.ZipFile, member: str, model: Wavefront) -> list[Material]:
    materials: dict[str, Material] = {}
    for name in model.libraries:
        try:
            materials |= read_mtl(_text(files, _beside(member, name)))
        except (KeyError, ValueError):
            continue
    return [materials.get(name, Material()) for name in model.names]


def _colour(files: zipfile.ZipFile, member: str, look: Material) -> FloatArray:
    """The diffuse colour, or the picture's mean where it can be read."""
    if look.picture and find_spec("cv2") is not None:
        import cv2

        try:
            data = np.frombuffer(files.read(_beside(member, look.picture)), np.uint8)
        except KeyError:
            data = np.zeros(0, np.uint8)
        image = cv2.imdecode(data, cv2.IMREAD_REDUCED_COLOR_8) if len(data) else None
        if image is not None:
            return np.asarray(image.mean(axis=(0, 1))[::-1], np.float32)
    return np.asarray(look.colour, np.float32) * 255


def _beside(member: str, name: str) -> str:
    return posixpath.join(posixpath.dirname(member), name)


def _text(files: zipfile.ZipFile, member: str) -> str:
    return files.read(member).decode("utf-8", errors="replace")
