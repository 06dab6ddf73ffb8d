"""How hard a data set is: overlap classes, relative yaw, and what guessing without looking gets.

python scripts/table_difficulty.py --dataset rooms
"""

from __future__ import annotations

from benchmark.catalogue import PAIR_METHODS
from benchmark.command import answered_pairs, opened, out_path, pair_list, pair_parser, settings
from benchmark.pair_table import overlap_table, yaw_table
from benchmark.pairs import difficulty
from benchmark.scoring import OVERLAPS, summarise, yaw_classes
from benchmark.table import Table, write

TRIVIAL = ("identity", "uniform_yaw", "manhattan_random", "manhattan_away")


def main() -> None:
    """Parse the arguments, run the trivial baselines, print the tables."""
    options = pair_parser(__doc__, "difficulty").parse_args()
    dataset = opened(options)
    pairs = pair_list(options, dataset)
    methods = {name: PAIR_METHODS[name] for name in TRIVIAL}
    rows = answered_pairs(options, dataset, pairs, list(methods.values()))
    summary = {
        name: {
            "overlap": summarise(rows[method.key], OVERLAPS),
            "yaw": summarise(rows[method.key], yaw_classes()),
        }
        for name, method in methods.items()
    }
    hard = difficulty(pairs.pairs)
    where = f"{dataset.name}, {len(pairs.pairs)} pairs, seed {options.seed}"
    tables = [
        _shares(f"True overlap, {where}", hard["overlap"]),
        _shares(f"True relative yaw in degrees, {where}", hard["yaw_deg"]),
        overlap_table(f"Guessing, {where}", methods, summary),
        yaw_table(f"Guessing, {where}", methods, summary),
    ]
    results = {**settings(options, dataset), "difficulty": hard, "methods": summary}
    print(write(out_path(options, dataset), results, tables))


def _shares(title: str, shares: dict[str, float]) -> Table:
    cells = ["share", *(f"{share:.1%}" for share in shares.values())]
    return Table(title, "Share of pairs.", ("", *shares), [cells])


if __name__ == "__main__":
    main()
