"""Two rooms in one folder, and corridors whose halves look alike: who is wrong, and how surely.

    python scripts/check_ambiguity.py --rooms 3 --corridors 2

Scans of two rooms must come out as two components. In a corridor every view of one half has a
twin in the other, so a confident wrong place is a defect and a doubtful one is not.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from benchmark.ambiguity import Mixture, look_alike, score, two_rooms
from benchmark.corridors import Likeness
from benchmark.table import Table, write
from fewview import config, pipeline
from fewview.errors import FewviewError

Json = dict[str, Any]
NOTE = (
    "Components: scans of each place. Wrong: scans more than 15 degrees or 0.3 m off relative to "
    "the majority of their component, the probability of the surest of them, and whether an "
    "alternative has none. Candidate: the highest probability that a pair gave to a wrong pose."
)
HEAD = ("set", "components", "unplaced", "wrong", "surest", "among alternatives", "candidate")


def main() -> None:
    """Parse the arguments, run, print the tables."""
    options = arguments()
    settings = config.load(options.preset, None, tuple(options.set))
    rows: dict[str, list[Json]] = {"rooms": [], "corridors": []}
    for kind, mixture in mixtures(options):
        result = pipeline.reconstruct(mixture.scans, settings, options.seed, options.jobs)
        rows[kind].append(score(mixture, result))
        print(*cells(rows[kind][-1]), sep=" | ", file=sys.stderr)
    results = {"seed": options.seed, "config_hash": settings.hash(), **rows, "summary": {}}
    results["summary"] = {kind: summary(own) for kind, own in rows.items()}
    tables = [table(f"Ambiguous sets: {kind}", own) for kind, own in rows.items()]
    print(write(options.out, results, tables))


def arguments() -> argparse.Namespace:
    """The command line."""
    made = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    made.add_argument("--rooms", type=int, default=3, help="pairs of rooms")
    made.add_argument("--scans", type=int, default=6, help="of each room")
    made.add_argument("--corridors", type=int, default=2, help="corridors of each likeness")
    made.add_argument("--each", type=int, default=3, help="scans of each half of a corridor")
    made.add_argument("--middle", type=int, default=2, help="scans that show both halves")
    made.add_argument("--seed", type=int, default=0, help="of views and runs")
    made.add_argument("--preset", default="default")
    made.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    made.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)), help="threads")
    made.add_argument("--out", type=Path, default=Path("results/ambiguity.json"))
    return made.parse_args()


def mixtures(options: argparse.Namespace) -> Iterator[tuple[str, Mixture]]:
    """The sets, each under the table that it belongs to."""
    for pair in range(options.rooms):
        yield "rooms", two_rooms((2 * pair, 2 * pair + 1), options.scans, options.seed)
    for likeness in Likeness:
        for middle in dict.fromkeys((0, options.middle)):
            made, seed = 0, options.seed
            while made < options.corridors:
                try:
                    yield "corridors", look_alike(likeness, options.each, middle, seed)
                    made += 1
                except FewviewError as error:
                    print(f"{likeness} corridor {seed}: {error}", file=sys.stderr)
                seed += 1


def summary(rows: Sequence[Json]) -> Json:
    """Of all sets of a table together."""
    return {
        "sets": len(rows),
        "mixed_components": sum(len(set(c)) > 1 for row in rows for c in row["components"]),
        "placed": sum(row["placed"] for row in rows),
        "wrong": sum(len(row["wrong"]) for row in rows),
        "surest_wrong": max((row["surest_wrong"] for row in rows), default=0.0),
    }


def table(title: str, rows: Sequence[Json]) -> Table:
    """One row a set."""
    return Table(title, NOTE, HEAD, [cells(row) for row in rows])


def cells(row: Json) -> list[str]:
    """A set's row."""
    parts = [" + ".join(f"{n} {p}" for p, n in Counter(c).items()) for c in row["components"]]
    offered = {None: "-", True: "yes", False: "no"}[row["truth_among_alternatives"]]
    return [
        row["name"],
        " / ".join(parts) or "none",
        str(len(row["probabilities"]) - row["placed"]),
        str(len(row["wrong"])),
        f"{row['surest_wrong']:.2f}" if row["wrong"] else "-",
        offered,
        f"{row['surest_wrong_candidate']:.2f}",
    ]


if __name__ == "__main__":
    main()
