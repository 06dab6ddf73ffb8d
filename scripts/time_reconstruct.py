"""End-to-end time and memory of ``fewview reconstruct`` beside a peer, in turn, on the same sets.

    python scripts/time_reconstruct.py --dataset DATA/redkitchen --size 20 --repeat 3

fewview also fuses the mesh and writes the recording; the peer computes poses only. Compare the
ratio: the seconds are those of one machine at one moment.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.catalogue import MULTI_METHODS
from benchmark.command import opened, out_path, parser, settings
from benchmark.measure import Measured, measure
from benchmark.sets import frame_sets
from benchmark.table import Table, write

Json = dict[str, Any]
SCRIPTS = Path(__file__).resolve().parent
FINISHED = (0, 3)
"""Exit codes after which there is a result: everything placed, or some scans left out."""
NOTE = "Median over sets and repetitions, alternating; ratio to the peer in brackets."


def main() -> None:
    """Parse the arguments, measure, print the table."""
    made = parser(__doc__, "time-reconstruct")
    made.add_argument("--size", type=int, default=20, help="scans of a set")
    made.add_argument("--sets", type=int, default=2, help="random sets")
    made.add_argument("--repeat", type=int, default=2, help="runs of each set")
    made.add_argument("--peer", choices=sorted(MULTI_METHODS), default="xfeat_robustrec")
    options = made.parse_args()
    dataset = opened(options)
    scene = dataset.scenes[0]
    sets = frame_sets(
        scene,
        "random",
        counts={options.size: options.sets},
        limit=options.sets,
        seed=options.seed,
        cache=options.cache,
    )
    runs: dict[str, list[Json]] = {"fewview": [], options.peer: []}
    for chosen in [s for s in sets if len(s.names) == options.size]:
        with tempfile.TemporaryDirectory() as name:
            scans = Path(name) / "scans"
            scene.write(chosen.names, scans)
            for repetition in range(options.repeat):
                for method, own in runs.items():
                    told = f"{chosen.id}, {method}, {repetition + 1} of {options.repeat}"
                    print(told, file=sys.stderr)
                    own.append({"set": chosen.id, **_run(method, scans, options.jobs)})
    results = {**settings(options, dataset), "size": options.size, "runs": runs}
    print(write(out_path(options, dataset), results, [_table(runs, scene.name, options.size)]))


def _run(method: str, scans: Path, jobs: int) -> Json:
    with tempfile.TemporaryDirectory() as name:
        out = Path(name)
        command: Sequence[str | Path] = [sys.executable, "-m", "fewview", "reconstruct", scans]
        command = [*command, "--out", out / "mesh.ply"]
        if method != "fewview":
            command = [sys.executable, "-m", "benchmark.peer", scans]
            command = [*command, "--method", method, "--out", out / "poses.json"]
        environment = {"OMP_NUM_THREADS": "1", "PYTHONPATH": f"{SCRIPTS.parent}:{SCRIPTS}"}
        measured: Measured = measure([*command, "--jobs", str(jobs)], environment, out)
        if measured.code not in FINISHED:
            raise SystemExit(f"{method} failed:\n{measured.errors}")
        report = out / "mesh.json"
        stages = json.loads(report.read_text())["timings_s"] if report.is_file() else None
        taken = {name: value for name, value in asdict(measured).items() if name != "errors"}
        return {**taken, "stages_s": stages}


def _table(runs: dict[str, list[Json]], scene: str, size: int) -> Table:
    names = ("wall_s", "cpu_s", "peak_mb")
    medians = {m: [float(np.median([r[n] for r in own])) for n in names] for m, own in runs.items()}
    peer = list(medians.values())[-1]
    rows = [
        [method, *(f"{a:.1f} [{a / b:.2f}]" for a, b in zip(own, peer, strict=True))]
        for method, own in medians.items()
    ]
    return Table(f"{scene}, {size} scans", NOTE, ("method", "wall s", "CPU s", "peak MB"), rows)


if __name__ == "__main__":
    main()
