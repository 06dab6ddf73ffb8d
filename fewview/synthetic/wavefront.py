"""Wavefront OBJ models and MTL materials: shapes and colours, without pictures laid on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fewview.types import Array, IntArray

_GREY = (0.8, 0.8, 0.8)


@dataclass(frozen=True)
class Material:
    """What a surface looks like.

    Attributes:
        colour: diffuse RGB, 0..1.
        opacity: 0 invisible to 1 solid.
        picture: file name of the picture laid on it, empty for none.
    """

    colour: tuple[float, float, float] = _GREY
    opacity: float = 1.0
    picture: str = ""


@dataclass(frozen=True, eq=False)
class Wavefront:
    """A model as its file has it: x to the right, y up, z to the front, any unit.

    Attributes:
        vertices: (n, 3).
        triangles: (m, 3) indices of vertices; larger faces are cut into fans.
        material: (m,) index into ``names``.
        names: of the materials, in the order of their first use.
        libraries: the MTL files that describe them.
    """

    vertices: Array
    triangles: IntArray
    material: IntArray
    names: tuple[str, ...]
    libraries: tuple[str, ...]


def read_obj(text: str) -> Wavefront:
    """Read the faces of an OBJ file.

    Raises:
        ValueError: a number cannot be read, or a face names a vertex that is not there.
    """
    vertices: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    material: list[int] = []
    names: dict[str, int] = {}
    libraries: list[str] = []
    current = ""
    for line in text.replace("\\\n", " ").splitlines():
        key, _, rest = line.strip().partition(" ")
        if key == "v":
            vertices.append([float(number) for number in rest.split()[:3]])
        elif key == "mtllib":
            libraries.append(rest.strip())
        elif key == "usemtl":
            current = rest.strip()
        elif key == "f":
            first, *others = (_index(corner, len(vertices)) for corner in rest.split())
            fan = [(first, *pair) for pair in zip(others[:-1], others[1:], strict=True)]
            triangles += fan
            material += [names.setdefault(current, len(names))] * len(fan)
    corners = np.array(triangles, np.int64).reshape(-1, 3)
    if corners.size and not 0 <= corners.min() <= corners.max() < len(vertices):
        raise ValueError("a face names a vertex that is not there")
    return Wavefront(
        np.array(vertices, np.float64).reshape(-1, 3),
        corners,
        np.array(material, np.int64),
        tuple(names),
        tuple(libraries),
    )


def _index(corner: str, count: int) -> int:
    number = int(corner.partition("/")[0])
    return number - 1 if number > 0 else count + number


def read_mtl(text: str) -> dict[str, Material]:
    """Materials by name; what is not said of one is as in `Material`.

    Raises:
        ValueError: a number cannot be read.
    """
    said: dict[str, dict[str, str]] = {}
    properties: dict[str, str] = {}
    for line in text.splitlines():
        key, _, rest = line.strip().partition(" ")
        if key == "newmtl":
            properties = said.setdefault(rest.strip(), {})
        else:
            properties[key.lower()] = rest.strip()
    return {name: _material(values) for name, values in said.items()}


def _material(properties: dict[str, str]) -> Material:
    red, green, blue = (properties.get("kd", "").split() + [""] * 3)[:3]
    colour = (float(red), float(green), float(blue)) if blue else _GREY
    opacity = float(properties.get("d", "1").split()[-1])
    picture = properties.get("map_kd", "")
    return Material(colour, opacity, picture.split()[-1] if picture.startswith("-") else picture)
