"""Completed rooms as pictures: a file for each of some scans, with the truth where it is known.

    python scripts/figure_completion.py --dataset DATA/redkitchen --rows 4
    python scripts/figure_completion.py --dataset rooms --rows 4 --networks results/train_panorama

Scans are taken evenly over a recording, or one view from each of so many generated rooms.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from benchmark.command import parser
from benchmark.completion_draw import Subject, drawn
from benchmark.completion_networks import Networks, add_networks
from benchmark.completion_views import GeneratedRoom, SceneFrames, ring_of
from benchmark.datasets import SPLITS, open_dataset
from benchmark.scenes import Scene

SMALL = (cv2.IMWRITE_PNG_COMPRESSION, 9)
"""Lossless: colours stand for classes."""


def main() -> None:
    """Parse the arguments, draw."""
    made = parser(__doc__, "completion")
    made.add_argument("--rows", type=int, default=4, help="scans drawn, of each scene")
    add_networks(made)
    options = made.parse_args()
    networks = Networks.found(options.networks)
    for subject in _subjects(options.dataset, options.rows, options.quick, options.cache):
        out = options.out or Path("results") / f"{options.table}.json"
        path = out.with_name(f"{out.stem}-{subject.name}.png")
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), cv2.cvtColor(drawn(subject, networks), cv2.COLOR_RGB2BGR), SMALL)
        print(path)


def _subjects(spec: str, rows: int, quick: bool, cache: Path) -> Iterator[Subject]:
    if spec in SPLITS:
        for index in range(rows):
            (view,) = GeneratedRoom(SPLITS[spec], index, 1).views()
            yield Subject(f"{SPLITS[spec]}-{index}", None, view.ring, view.points, view)
        return
    for scene in open_dataset(spec, quick=quick, cache=cache).scenes:
        chosen = np.unique(np.linspace(0, len(scene.names) - 1, rows).astype(int))
        yield from (_subject(scene, scene.names[i]) for i in chosen)


def _subject(scene: Scene, name: str) -> Subject:
    frame, title = scene.load(name), f"{scene.name}-{name}"
    if not scene.has_mesh:
        return Subject(title, frame.colour, *ring_of(frame), None)
    (view,) = SceneFrames(scene, (name,)).views()
    return Subject(title, frame.colour, view.ring, view.points, view)


if __name__ == "__main__":
    main()
