"""A small furniture library: models made of boxes, in a catalogue as Sweet Home 3D has them."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fewview.synthetic.surfaces import box_corners

Box = tuple[Sequence[float], Sequence[float], str]
"""Width, depth and height; middle of the bottom; material. Centimetres, y to the front, z up."""

CHAIR: tuple[Box, ...] = (
    ((45, 45, 45), (0, 0, 0), "red"),
    ((45, 5, 45), (0, -20, 45), "green"),
)
TABLE: tuple[Box, ...] = (((120, 70, 4), (0, 0, 70), "red"), ((10, 10, 70), (40, 0, 0), "green"))
SOFA: tuple[Box, ...] = (((190, 90, 40), (0, 0, 0), "red"), ((190, 20, 40), (0, -35, 40), "green"))
BED: tuple[Box, ...] = (((140, 200, 50), (0, 0, 0), "red"), ((140, 5, 45), (0, -97.5, 50), "green"))
CABINET: tuple[Box, ...] = (((100, 40, 80), (0, 0, 0), "green"),)
SHAPES: Mapping[str, tuple[Box, ...]] = {
    "Chair": CHAIR, "Table": TABLE, "Sofa": SOFA, "Bed": BED, "Cabinet": CABINET,
}  # fmt: skip
MTL = """newmtl red
Kd 1 0 0
newmtl green
Kd 0 1 0
d 1
newmtl glass
Kd 1 1 1
d 0.1
"""


def obj_of(boxes: Sequence[Box]) -> str:
    """Boxes as OBJ text: x to the right, y up, z to the front."""
    lines, count = ["mtllib model.mtl"], 0
    for size, bottom, material in boxes:
        lines.append(f"usemtl {material}")
        for face in box_corners(size, bottom):
            lines += [f"v {-x} {z} {y}" for x, y, z in face.tolist()]
            lines.append("f " + " ".join(f"{count + i}/{i}/1" for i in (1, 2, 3, 4)))
            count += 4
    return "\n".join(lines)


def extent(boxes: Sequence[Box]) -> tuple[float, float, float]:
    """Width, depth and height of boxes, centimetres."""
    faces = np.concatenate([box_corners(size, bottom) for size, bottom, _ in boxes])
    width, depth, height = np.ptp(faces.reshape(-1, 3), axis=0).tolist()
    return width, depth, height


def properties(number: int, title: str, boxes: Sequence[Box], **more: str) -> dict[str, str]:
    """What a catalogue says of a model; its file is of that number."""
    width, depth, height = extent(boxes)
    return {
        "id": f"Test#{title}-{number}", "name": title, "category": "Living room",
        "model": f"/models/{number}/model.obj", "width": f"{width}", "depth": f"{depth}",
        "height": f"{height}", "doorOrWindow": "false", "creator": "Jos\\u00e9", **more,
    }  # fmt: skip


def write_catalogue(
    file: Path, models: Sequence[tuple[dict[str, str], str]], licence: str = "CC-BY 3.0 \xa9 Test"
) -> None:
    """Write properties and OBJ texts of models as a catalogue."""
    lines = ["# a comment", "id=Test", "name=Test models", f"license={licence}"]
    with zipfile.ZipFile(file, "w") as archive:
        for number, (said, obj) in enumerate(models):
            lines += [f"{key}#{number + 1}={value}" for key, value in said.items()]
            archive.writestr(said["model"].lstrip("/"), obj)
            archive.writestr(f"models/{number}/model.mtl", MTL)
        archive.writestr("PluginFurnitureCatalog.properties", "\n".join(lines).encode("latin-1"))


def write_library(folder: Path, copies: int = 12) -> None:
    """Write a catalogue of some models of each shape."""
    titled = [(title, boxes) for title, boxes in SHAPES.items() for _ in range(copies)]
    models = [(properties(n, t, boxes), obj_of(boxes)) for n, (t, boxes) in enumerate(titled)]
    write_catalogue(folder / "test.sh3f", models)
