"""CPU time of the global stage on planted graphs of all pairs, by scans and candidates a pair.

python scripts/time_global.py --out docs/measurements/global_time.json
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from benchmark.planted_graphs import planted_graph, upright_levelling
from benchmark.table import Table, write
from fewview.config import Config
from fewview.executor import single_threaded_libraries
from fewview.global_stage import solve

SCANS, TOP_K = (5, 10, 20, 40, 60), (1, 3, 5, 10)
NOTE = "CPU seconds of the whole stage on one core: answers, alternatives, beliefs, pose graph."


def main() -> None:
    """Parse the arguments, measure, print the table."""
    made = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    made.add_argument("--seed", type=int, default=0, help="of the graphs")
    made.add_argument("--out", type=Path, required=True, help="JSON; .md and .tex beside it")
    options = made.parse_args()
    with single_threaded_libraries():
        seconds = {n: {k: measured(n, k, options.seed) for k in TOP_K} for n in SCANS}
    rows = [[f"{n} scans", *(f"{own[k]:.2f}" for k in TOP_K)] for n, own in seconds.items()]
    head = ("", *(f"{k} candidates" for k in TOP_K))
    results = {"seed": options.seed, "cpu_seconds": seconds}
    print(write(options.out, results, [Table("Time of the global stage", NOTE, head, rows)]))


def measured(scans: int, top_k: int, seed: int) -> float:
    """CPU seconds of one solution."""
    poses, pairs = planted_graph(seed, scans, top_k)
    names = [f"scan-{i:02d}" for i in range(scans)]
    levellings = [upright_levelling(pose) for pose in poses]
    start = time.process_time()
    solve(names, levellings, pairs, Config().global_stage, seed)
    return round(time.process_time() - start, 3)


if __name__ == "__main__":
    main()
