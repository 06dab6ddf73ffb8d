"""Relative pose of two scans: fewview and its baselines (the paper's baseline table).

    python scripts/table_pairwise.py --dataset rooms --out results/pairwise.json

Answers are kept: a second run scores them again, a run that was killed goes on where it was.
"""

from __future__ import annotations

from benchmark.catalogue import PAIR_METHODS
from benchmark.command import method_names, pair_parser
from benchmark.pair_table import make

METHODS = (
    "identity,uniform_yaw,manhattan_random,manhattan_away,4pcs,fgr,fgr_icp,ransac_icp,kiss_icp,"
    "xfeat_icp,sparse_icp,scan_complete,ours_local,ours_global,ours"
)


def main() -> None:
    """Parse the arguments, run, print the table."""
    parser = pair_parser(__doc__, "pairwise")
    parser.add_argument("--methods", type=method_names, default=method_names(METHODS))
    options = parser.parse_args()
    methods = {name: PAIR_METHODS[name] for name in options.methods}
    print(make(options, methods, "Relative poses")[1])


if __name__ == "__main__":
    main()
