"""Ways to solve the discrete problem: energy, accuracy and time on the same problems.

    python scripts/table_inference.py --dataset rooms:validation --sets random extreme
    python scripts/table_inference.py --dataset none --problems FOLDER

Planted graphs always, and with them the sets of a data set, or the problems in a folder of files
(see `benchmark.inference.problems.filed`). toulbar2 takes part where it is installed.
"""

from __future__ import annotations

import itertools
import sys
from pathlib import Path

from benchmark.command import parser
from benchmark.few_view import KINDS_NOTE
from benchmark.inference import cost_network
from benchmark.inference.compare import rows_of, summary_of, table_of
from benchmark.inference.methods import methods
from benchmark.inference.problems import answered, filed, planted
from benchmark.table import write
from fewview.config import Config
from fewview.executor import single_threaded_libraries

NO_DATASET = "none"


def main() -> None:
    """Parse the arguments, run, print the table."""
    made = parser(__doc__, "inference")
    made.add_argument("--sets", nargs="+", default=["random"], help=KINDS_NOTE)
    made.add_argument("--problems", type=Path, help="folder of files with problems")
    options = made.parse_args()
    if not cost_network.available():
        print("toulbar2 is left out: pip install pytoulbar2", file=sys.stderr)
    config, known = Config().global_stage, methods()
    problems = [planted(config, options.quick)]
    if options.problems:
        problems.append(filed(options.problems, config))
    if options.dataset != NO_DATASET:
        problems.append(answered(options, config))
    with single_threaded_libraries():
        rows = rows_of(known, itertools.chain(*problems), options.seed)
    summary = summary_of(rows)
    table = table_of(summary, known, "Inference in the discrete stage")
    out = options.out or Path("results") / f"inference-{options.dataset.replace(':', '-')}.json"
    results = {
        "dataset": options.dataset,
        "seed": options.seed,
        "quick": options.quick,
        "methods": {name: method.label for name, method in known.items()},
        "summary": summary,
        "rows": rows,
    }
    print(write(out, results, [table]))


if __name__ == "__main__":
    main()
