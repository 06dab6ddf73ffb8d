"""Data sets by one word or folder: generated rooms, ScanNet, Matterport3D, or any scans."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmark.rooms import VIEWS, rooms
from benchmark.scenes import Scene
from fewview.errors import ScanError
from fewview.scans import matterport
from fewview.scans.assembly import MAX_SCANS
from fewview.scans.registry import find_reader
from fewview.synthetic import Split

ROOMS, QUICK_SCENES = 40, 6
"""Generated rooms of a data set; scenes of any data set when it has to be quick."""
ROOM_RADIUS_M = 3.0
"""Views of a house this close to each other count as those of one room."""
SPLITS: dict[str, Split] = {"rooms": "test", "rooms:test": "test", "rooms:validation": "validation"}
SPECS = f"{', '.join(SPLITS)}, or a folder with one scene or with a folder (.sens file) a scene"
"""What `open_dataset` understands, for help texts."""
SEED = 0


@dataclass(frozen=True)
class Dataset:
    """Scenes to measure on.

    Attributes:
        name: short, for file names and table headings.
        scenes: at least one, of different names.
        spec: what it was asked for by.
    """

    name: str
    scenes: tuple[Scene, ...]
    spec: str


def open_dataset(spec: str, *, quick: bool, cache: Path, count: int | None = None) -> Dataset:
    """Find, and for generated rooms make, the scenes of a data set.

    A scene given alone keeps all its frames, or 150 where the readers take no more. Of each scene
    of a larger data set 25 views are taken, with a fixed seed from the whole recording, as in the
    paper (Sec. 4); those of a Matterport3D house, from within `ROOM_RADIUS_M` of one of its views.

    Args:
        spec: see `SPECS`.
        quick: fewer scenes.
        cache: where generated rooms are kept.
        count: generated rooms, `ROOMS` or when quick `QUICK_SCENES` when not given.

    Raises:
        SystemExit: there is nothing that can be used; the message says why.
    """
    if spec in SPLITS:
        count = count or (QUICK_SCENES if quick else ROOMS)
        made = rooms(SPLITS[spec], count, VIEWS, cache, SEED)
        return Dataset(f"rooms-{SPLITS[spec]}", tuple(made), spec)
    folder = Path(spec)
    if not folder.exists():
        raise SystemExit(f"{spec} is no data set: give {SPECS}")
    try:
        scenes = _scenes(folder.resolve(), quick)
    except ScanError as error:
        raise SystemExit(str(error)) from error
    return Dataset(scenes[0].name if len(scenes) == 1 else folder.resolve().name, scenes, spec)


def _scenes(folder: Path, quick: bool) -> tuple[Scene, ...]:
    if _format(folder):
        scene = _checked(Scene(folder))
        return (scene if len(scene.names) <= MAX_SCANS else scene.limited(SEED),)
    found = [path for path in sorted(folder.iterdir()) if _format(path)]
    if not found:
        raise SystemExit(f"{folder} holds no scans of a known layout, and no folder in it does")
    return tuple(_few_views(_checked(Scene(p))) for p in found[: QUICK_SCENES if quick else None])


def _format(path: Path) -> str | None:
    try:
        return find_reader(path)[0].NAME
    except ScanError:
        return None


def _checked(scene: Scene) -> Scene:
    if len(scene.names) < 2:
        raise SystemExit(f"{scene.folder} has fewer than 2 frames with a true pose: add the poses")
    return scene


def _few_views(scene: Scene) -> Scene:
    if len(scene.names) <= VIEWS:
        return scene
    rng = np.random.default_rng([SEED, zlib.crc32(scene.name.encode())])
    names = scene.names
    if _format(scene.folder) == matterport.NAME:
        eyes = np.stack([scene.truth[name][:3, 3] for name in names])
        away = np.linalg.norm(eyes - eyes[rng.integers(len(names))], axis=1)
        names = tuple(name for name, d in zip(names, away, strict=True) if d <= ROOM_RADIUS_M)
    chosen = np.sort(rng.choice(len(names), min(VIEWS, len(names)), replace=False))
    return replace(scene, only=tuple(names[i] for i in chosen))
