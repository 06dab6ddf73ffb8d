"""Global initialisation times local refinement (the paper's local table).

    python scripts/table_local.py --dataset rooms

ScanComplete is the paper's base for the global side, SparseICP for the local one.
"""

from __future__ import annotations

from dataclasses import replace

from benchmark.catalogue import LOCAL_LABELS, PAIR_METHODS, Method
from benchmark.command import pair_parser
from benchmark.pair_table import make

GLOBAL = ("scan_complete", "ransac", "xfeat", "ours_global")


def combined(base: str, local: str | None) -> Method:
    """A global method, followed by a local one."""
    method = PAIR_METHODS[base]
    label = f"{method.label} + {'nothing' if local is None else LOCAL_LABELS[local]}"
    return replace(method, label=label, local=local)


def main() -> None:
    """Parse the arguments, run, print the table."""
    options = pair_parser(__doc__, "local").parse_args()
    methods = {
        f"{base}+{local}": combined(base, local)
        for base in GLOBAL
        for local in (None, *LOCAL_LABELS)
    }
    methods["ours"] = PAIR_METHODS["ours"]
    print(make(options, methods, "Global and local modules combined")[1])


if __name__ == "__main__":
    main()
