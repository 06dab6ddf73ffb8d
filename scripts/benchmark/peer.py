"""A multi-scan baseline as a command: ``python -m benchmark.peer FOLDER --method NAME``."""

from __future__ import annotations

import argparse
import itertools
import json
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from pathlib import Path

from benchmark.catalogue import MULTI_METHODS, PAIR_METHODS
from fewview import scans
from fewview.executor import single_threaded_libraries
from fewview.types import Frame


def main() -> None:
    """Pose the scans of a folder and write the poses as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--method", choices=sorted(MULTI_METHODS), required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    multi = MULTI_METHODS[options.method]
    method = PAIR_METHODS[multi.pairs].make()
    read = scans.load(options.folder).scans
    with single_threaded_libraries(), ThreadPoolExecutor(options.jobs) as pool:
        frames: list[Frame] = list(pool.map(lambda scan: scan.load(), read))
        views = list(pool.map(method.prepare, frames))
        pairs = list(itertools.combinations(range(len(views)), 2))
        found = pool.map(lambda pair: method.match(views[pair[0]], views[pair[1]]), pairs)
        answers = dict(zip(pairs, found, strict=True))
    solve = import_module(multi.backend).solve
    placements = solve([s.name for s in read], frames.__getitem__, answers, **multi.arguments)
    poses = [None if p is None else p.world_T_scan.tolist() for p in placements]
    options.out.write_text(json.dumps(poses))


if __name__ == "__main__":
    main()
