"""Generated rooms as a data set; they stand for SUNCG, which has been withdrawn.

What `fewview.synthetic` makes of a seed:

- boxes, L and T shapes with niches, chimney breasts, cut corners and slanted walls, turned by any
  angle; attics and lowered ceilings; doors open into a second room or a corridor,
- furniture by what a room is for, along walls and in groups; textures, pictures, lamps, shadows,
- hand-held cameras 1.2-1.7 m high, pitched by -30 to 5 degrees and rolled by up to 5, looking
  anywhere,
- Kinect-like depth: noise that grows with the square of the depth, quantised disparity, 0.4-5 m,
  holes at edges, at grazing angles and in blotches; colour with noise, exposure and white balance.

Rooms of different splits share no seed (`fewview.synthetic.split_seed`).
"""

from __future__ import annotations

import hashlib
import multiprocessing
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from benchmark.scenes import Scene
from fewview import synthetic

Size = tuple[int, int]
VIEWS = 25
"""Of a room, as in the paper (Sec. 4, datasets: 25 random camera locations a room)."""


@dataclass(frozen=True)
class Recipe:
    """Everything that a room's files depend on, beside the code."""

    folder: Path
    room_seed: int
    views: int
    seed: int
    size: Size


def rooms(
    split: synthetic.Split,
    count: int,
    views: int,
    cache: Path,
    seed: int = 0,
    size: Size = (640, 480),
    jobs: int = 2,
) -> list[Scene]:
    """The first rooms of a split, each with random views and its true mesh.

    Args:
        split: ``"validation"``, ``"test"``, ...
        count: number of rooms.
        views: of each room.
        cache: where rooms are kept; those that it lacks are made, each complete or not at all.
        seed: which views of a room.
        size: width and height of the images, pixels.
        jobs: processes that make rooms.
    """
    root = cache / f"rooms-{_key(views, seed, size)}"
    recipes = [
        Recipe(root / f"{split}-{i:03d}", synthetic.split_seed(split, i), views, seed, size)
        for i in range(count)
    ]
    _make_all([recipe for recipe in recipes if not recipe.folder.is_dir()], jobs)
    return [Scene(recipe.folder) for recipe in recipes]


def make(recipe: Recipe) -> None:
    """Render a room and write it, complete or not at all."""
    scene = synthetic.generate(
        recipe.room_seed, recipe.views, recipe.seed, synthetic.ViewMode.RANDOM, *recipe.size
    )
    recipe.folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=recipe.folder.parent, prefix=".room-") as partial:
        synthetic.write(Path(partial) / "room", scene)
        try:
            (Path(partial) / "room").rename(recipe.folder)
        except OSError:
            if not recipe.folder.is_dir():  # another run was first
                raise


def _make_all(recipes: Sequence[Recipe], jobs: int) -> None:
    if not recipes:
        return
    if jobs == 1 or len(recipes) == 1:
        for recipe in tqdm(recipes, desc="rooms", unit="room"):
            make(recipe)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context) as pool:
        for _ in tqdm(pool.map(make, recipes), total=len(recipes), desc="rooms", unit="room"):
            pass


def _key(views: int, seed: int, size: Size) -> str:
    """Changes with the code that makes rooms and with what it is asked for."""
    digest = hashlib.sha256(repr((views, seed, size)).encode())
    for path in sorted(Path(synthetic.__file__).parent.glob("*.py")):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:12]
