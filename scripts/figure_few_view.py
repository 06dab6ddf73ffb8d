"""Sets of scans from above, as each method places them, beside the truth (the paper's Fig. 1).

python scripts/figure_few_view.py --dataset DATA/redkitchen --sets low --rows 4
"""

from __future__ import annotations

import numpy as np

from benchmark.catalogue import MULTI_METHODS
from benchmark.command import multi_names, opened, out_path, parser
from benchmark.draw import set_row
from benchmark.few_view import KINDS_NOTE, sets_of
from benchmark.page import grid, save_png
from benchmark.store import Store
from benchmark.tasks import SetTask, run_sets

METHODS = "fine2coarse,robustrec,xfeat_robustrec,ours_top5"


def main() -> None:
    """Parse the arguments, run what is missing, draw."""
    made = parser(__doc__, "few-view")
    made.add_argument("--sets", nargs="+", default=["random"], help=KINDS_NOTE)
    made.add_argument("--methods", type=multi_names, default=multi_names(METHODS))
    made.add_argument("--rows", type=int, default=4, help="sets drawn")
    options = made.parse_args()
    dataset = opened(options)
    store = Store(options.cache / "answers")
    sets = sets_of(dataset, options.sets, options.quick, options.seed, options.cache)
    sets = [sets[i] for i in np.unique(np.linspace(0, len(sets) - 1, options.rows).astype(int))]
    tasks = [
        [SetTask(store, MULTI_METHODS[name], scene, one.names) for name in options.methods]
        for scene, one in sets
    ]
    run_sets([task for row in tasks for task in row], options.jobs)
    rows = [drawn(row) for row in tasks]
    titles = [f"{scene.name}\n{one.id}" for scene, one in sets]
    picture = grid([list(row.values()) for row in rows], list(rows[0]), titles)
    out = out_path(options, dataset).with_suffix(".png")
    out.parent.mkdir(parents=True, exist_ok=True)
    save_png(picture, out)
    print(out)


def drawn(tasks: list[SetTask]) -> dict[str, np.ndarray]:
    """Panels of one set by column title; the largest component of each method."""
    scene, names = tasks[0].scene, tasks[0].names
    poses = {task.method.label: task.largest() for task in tasks}
    frames = [scene.load(name) for name in names]
    return set_row(frames, poses, [scene.truth[name] for name in names], scene.up)


if __name__ == "__main__":
    main()
