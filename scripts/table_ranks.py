"""Which of the K candidates is the best one: the paper's rank distribution, beside the paper's.

python scripts/table_ranks.py --dataset rooms
"""

from __future__ import annotations

from benchmark.catalogue import PAIR_METHODS
from benchmark.command import answered_pairs, opened, out_path, pair_list, pair_parser, settings
from benchmark.scoring import OVERLAPS, best_ranks
from benchmark.table import Table, write

METHODS = ("ours_global", "ours")
PAPER = (0.42, 0.17, 0.17, 0.10, 0.14)
NOTE = (
    "Share of answered pairs whose candidate nearest to the truth in rotation has that rank; the "
    "paper orders by eigenvalue, fewview by probability."
)


def main() -> None:
    """Parse the arguments, run, print the table."""
    options = pair_parser(__doc__, "ranks").parse_args()
    dataset = opened(options)
    pairs = pair_list(options, dataset)
    methods = {name: PAIR_METHODS[name] for name in METHODS}
    answered = answered_pairs(options, dataset, pairs, list(methods.values()))
    ranks = {
        name: {
            group: best_ranks([row for row in answered[method.key] if fits(row)])
            for group, fits in OVERLAPS.items()
        }
        for name, method in methods.items()
    }
    rows = [["paper, all", "-", *(f"{share:.0%}" for share in PAPER)]]
    for name, groups in ranks.items():
        for group, found in groups.items():
            shares = [f"{share:.0%}" for share in found["shares"]]
            label = f"{methods[name].label}, overlap {group}"
            rows.append([label, f"{found['answered']} of {found['of']}", *shares])
    head = ("method", "answered", *(f"rank {k}" for k in range(1, len(PAPER) + 1)))
    table = Table(f"Rank of the best candidate, {dataset.name}", NOTE, head, rows)
    results = {**settings(options, dataset), "paper": PAPER, "ranks": ranks}
    print(write(out_path(options, dataset), results, [table]))


if __name__ == "__main__":
    main()
