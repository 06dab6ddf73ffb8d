"""Aligned clouds of each method beside the truth, a row a pair (the paper's baseline figure).

    python scripts/figure_pairs.py --dataset rooms --rows 6 --out results/pairs.png

Pairs are taken evenly over the overlap, from the list that the tables use.
"""

from __future__ import annotations

import numpy as np

from benchmark.catalogue import PAIR_METHODS
from benchmark.command import method_names, opened, out_path, pair_list, pair_parser
from benchmark.draw import pair_row
from benchmark.page import grid, save_png
from benchmark.pairs import Pair
from benchmark.run import run
from benchmark.scenes import Scene
from benchmark.store import Store
from benchmark.tasks import PairTask
from fewview.evaluation.metrics import relative

METHODS = "4pcs,fgr,ransac_icp,xfeat_icp,ours"


def main() -> None:
    """Parse the arguments, run what is missing, draw."""
    parser = pair_parser(__doc__, "pairs")
    parser.add_argument("--methods", type=method_names, default=method_names(METHODS))
    parser.add_argument("--rows", type=int, default=6, help="pairs drawn")
    options = parser.parse_args()
    dataset = opened(options)
    store, scenes = Store(options.cache / "answers"), {s.name: s for s in dataset.scenes}
    ordered = sorted(pair_list(options, dataset).pairs, key=lambda pair: -pair.overlap)
    chosen = [ordered[i] for i in np.linspace(0, len(ordered) - 1, options.rows).astype(int)]
    tasks = [
        [
            PairTask(store, PAIR_METHODS[name], scenes[pair.scene], pair.source, pair.target)
            for name in options.methods
        ]
        for pair in chosen
    ]
    run([task for row in tasks for task in row], options.jobs, "pairs")
    rows = [drawn(scenes[p.scene], p, row) for p, row in zip(chosen, tasks, strict=True)]
    titles = [f"overlap {pair.overlap:.0%}" for pair in chosen]
    picture = grid([list(row.values()) for row in rows], list(rows[0]), titles)
    out = out_path(options, dataset).with_suffix(".png")
    out.parent.mkdir(parents=True, exist_ok=True)
    save_png(picture, out)
    print(out)


def drawn(scene: Scene, pair: Pair, tasks: list[PairTask]) -> dict[str, np.ndarray]:
    """Panels by column title."""
    poses = {}
    for task in tasks:
        found = task.answer().candidates
        poses[task.method.label] = found[0].target_T_source if found else None
    truth = relative(scene.truth[pair.source], scene.truth[pair.target])
    up = scene.truth[pair.target][:3, :3].T @ scene.up
    return pair_row(scene.load(pair.source), scene.load(pair.target), poses, truth, up)


if __name__ == "__main__":
    main()
