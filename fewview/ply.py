"""Coloured meshes as binary PLY files."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np

from fewview.errors import FewviewError
from fewview.types import ColouredMesh

_VERTEX = np.dtype([("position", "<f4", 3), ("colour", "u1", 3)])
_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
_HEADER = """ply
format binary_little_endian 1.0
element vertex {vertices}
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
element face {faces}
property list uchar int vertex_indices
end_header
"""


def encode(mesh: ColouredMesh) -> bytes:
    """The bytes of a binary PLY file with vertex colours; positions become float32 metres."""
    vertices = np.empty(len(mesh.vertices), _VERTEX)
    vertices["position"], vertices["colour"] = mesh.vertices, mesh.colours
    faces = np.empty(len(mesh.faces), _FACE)
    faces["count"], faces["corners"] = 3, mesh.faces
    header = _HEADER.format(vertices=len(vertices), faces=len(faces))
    return header.encode() + vertices.tobytes() + faces.tobytes()


def write_ply(path: Path, mesh: ColouredMesh) -> None:
    """Write a mesh as `encode` does, whole or not at all.

    Raises:
        FewviewError: the file cannot be written.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        partial.write_bytes(encode(mesh))
        partial.replace(path)
    except OSError as error:
        raise FewviewError(f"{path}: cannot write the mesh ({error.strerror})") from error
    finally:
        partial.unlink(missing_ok=True)


def read_ply(path: Path) -> ColouredMesh:
    """Read a mesh that fewview wrote.

    Raises:
        FewviewError: the file is missing, cut short or of another layout.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise FewviewError(f"{path}: cannot read the mesh ({error.strerror})") from error
    pattern = _HEADER.format(vertices="([0-9]{1,10})", faces="([0-9]{1,10})")
    match = re.match(pattern.encode(), content)
    n, m = (int(count) for count in match.groups()) if match else (0, 0)
    start = match.end() if match else 0
    if not match or len(content) != start + n * _VERTEX.itemsize + m * _FACE.itemsize:
        raise FewviewError(f"{path}: not a mesh that fewview wrote, or cut short; write it again")
    vertices = np.frombuffer(content, _VERTEX, n, start)
    faces = np.frombuffer(content, _FACE, m, start + vertices.nbytes)
    return ColouredMesh(
        vertices["position"].astype(np.float64),
        faces["corners"].astype(np.int64),
        vertices["colour"].copy(),
    )
