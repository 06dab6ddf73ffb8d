"""Fit what tells which way up images are, and measure how often they are turned wrongly.

    python scripts/fit_orientation.py --scene FOLDER ... --check FOLDER ... --out FILE.json

Every second generated room and the folders given with --scene are fitted to; the other rooms and
the folders given with --check only show how the result carries over. The true turn of an image is
the one that brings it closest to the mean up direction of its scene. Sets of images are asked about
as they were taken, with half of them turned at random, and with all turned alike.
"""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import minimize
from scipy.special import log_softmax

from fewview.completion.levelling import upright
from fewview.completion.orientation import (
    CUES_LOGIT,
    MATCHES_LOGIT,
    chosen_turns,
    glance,
    match_votes,
    matches,
    upright_cues,
)
from fewview.executor import Executor
from fewview.types import Array, IntArray
from validation_views import Views, folder_views, views

FIRST_ROOM, VIEWS = 140, 10
"""Of the validation split, after those that other fits know."""
RIDGE = 0.1
SCENE_WEIGHT = 5.0
"""What a folder counts, of 1 for a room; whatever its number of images."""
SIZES, SETS = (5, 10, 15, 20), 6


@dataclass(frozen=True)
class Images:
    """The images of a scene, turned upright.

    Attributes:
        weight: of the scene; cues: (n, 4, 5) of each image at each turn.
        matches: (n, n, 4) of the pairs of an image and a later one at each relative turn.
    """

    weight: float
    cues: Array
    matches: Array


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rooms", type=int, default=44)
    parser.add_argument("--scene", type=Path, nargs="*", default=[])
    parser.add_argument("--check", type=Path, nargs="*", default=[])
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    rooms = [images_of(views(i, VIEWS), 1.0) for i in range(FIRST_ROOM, FIRST_ROOM + options.rooms)]
    folders = {
        path.name: images_of(folder_views(path), SCENE_WEIGHT)
        for path in [*options.scene, *options.check]
    }
    known = [folders[path.name] for path in options.scene]
    fit = [*rooms[::2], *known]
    result = {
        "matches_logit": fitted([match_cues(one) for one in fit], fit),
        "cues_logit": fitted([one.cues for one in fit], fit),
        "shipped": {"matches_logit": MATCHES_LOGIT.tolist(), "cues_logit": CUES_LOGIT.tolist()},
        "turned_wrongly_by_shipped": {
            "rooms fitted to": turned_wrongly(rooms[::2]),
            "other rooms": turned_wrongly(rooms[1::2]),
            **{name: turned_wrongly([one]) for name, one in folders.items()},
        },
    }
    text = json.dumps(result, indent=1)
    print(text)
    options.out.write_text(text + "\n")


def images_of(seen: Views, weight: float) -> Images:
    frames, poses = seen
    glances = list(Executor().map(glance, frames))
    true = true_turns(poses)
    cues = [np.roll(upright_cues(f), -t, axis=0) for f, t in zip(frames, true, strict=True)]
    found = np.zeros((len(frames), len(frames), 4))
    for i, j in itertools.combinations(range(len(frames)), 2):
        told = matches(glances[i].descriptors, glances[j].descriptors)
        found[i, j] = np.roll(told, true[i] - true[j])
    return Images(weight, np.stack(cues), found)


def true_turns(poses: Array) -> IntArray:
    """(n,) turns that bring images with (n, 4, 4) poses closest to their mean up direction."""
    up = -poses[:, :3, 1].mean(axis=0)
    axes = np.stack([upright(turns) for turns in range(4)])
    return np.asarray((axes @ np.swapaxes(poses[:, :3, :3], 1, 2) @ up).argmax(axis=1))


def match_cues(images: Images) -> Array:
    """(m, 4, 2) of all pairs."""
    found = images.matches[np.triu_indices(len(images.matches), 1)]
    return np.stack([np.log1p(found), np.sqrt(found)], axis=-1)


def fitted(cues: Sequence[Array], scenes: Sequence[Images]) -> list[float]:
    """Coefficients of a conditional logit in which turn 0 is right."""
    each = zip(cues, scenes, strict=True)
    weight = np.concatenate([np.full(len(rows), one.weight / len(rows)) for rows, one in each])
    every = np.concatenate(cues)

    def loss(w: Array) -> tuple[float, Array]:
        told = log_softmax(every @ w, axis=1)
        slope = np.einsum("nt,ntk->nk", np.exp(told), every) - every[:, 0]
        scale = VIEWS / RIDGE
        return w @ w - scale * (weight @ told[:, 0]), 2.0 * w + scale * (weight @ slope)

    found = minimize(loss, np.zeros(every.shape[2]), jac=True).x
    return [round(float(value), 2) for value in found]


def turned_wrongly(scenes: Sequence[Images]) -> dict[str, float]:
    """Share of the images that the shipped coefficients turn wrongly, by how sets were taken."""
    rng = np.random.default_rng(0)
    wrong: dict[str, list[float]] = {"as taken": [], "half turned": [], "all turned alike": []}
    for scene, size in itertools.product(scenes, SIZES):
        count = len(scene.cues)
        for _ in range(SETS if size <= count else 0):
            chosen = np.sort(rng.choice(count, size, replace=False))
            mixed = np.where(rng.random(size) < 0.5, rng.integers(1, 4, size), 0)
            alike = np.full(size, rng.integers(1, 4))
            for name, turns in zip(wrong, (np.zeros_like(mixed), mixed, alike), strict=True):
                wrong[name] += (found_turns(scene, chosen, turns) != turns).tolist()
    return {name: round(float(np.mean(values)), 4) for name, values in wrong.items()}


def found_turns(scene: Images, chosen: IntArray, turns: IntArray) -> IntArray:
    """The turns that are found for some images that need them."""
    own = log_softmax(scene.cues[chosen] @ CUES_LOGIT, axis=1)
    turned = [np.roll(row, turn) for row, turn in zip(own, turns, strict=True)]
    found = np.zeros((len(chosen), len(chosen), 4))
    for i, j in itertools.combinations(range(len(chosen)), 2):
        found[i, j] = np.roll(scene.matches[chosen[i], chosen[j]], turns[j] - turns[i])
    return chosen_turns(match_votes(found), np.stack(turned))


if __name__ == "__main__":
    main()
