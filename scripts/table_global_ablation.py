"""What each representation gives the global module (the paper's ablation).

    python scripts/table_global_ablation.py --dataset rooms

Every row is fewview without its local module and with some of its features.
"""

from __future__ import annotations

from benchmark.catalogue import PAIR_METHODS
from benchmark.command import pair_parser
from benchmark.pair_table import make

METHODS = (
    "panorama",
    "planes",
    "layout",
    "completed",
    "keypoints",
    "spectral",
    "ours_global",
)


def main() -> None:
    """Parse the arguments, run, print the table."""
    options = pair_parser(__doc__, "global-ablation").parse_args()
    methods = {name: PAIR_METHODS[name] for name in METHODS}
    print(make(options, methods, "Representations of the global module")[1])


if __name__ == "__main__":
    main()
