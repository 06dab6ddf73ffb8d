"""All training of the paper, in its three phases (Sec. 3.4), or one of them.

    python scripts/train_phases.py [--phase networks | parameters | joint] [--set KEY=VALUE ...]

    networks     every network alone; its weights replace those of the package, which the next
                 networks and phases build on (git has the ones before)
    parameters   gammas and alphas alone: scripts/fit_parameters.py
    joint        networks and hyper-parameters together: scripts/fit_joint.py

Settings go to every network (`store`, `library`, `steps`, ...). A run that was stopped goes on
where it was. The last two phases report what they changed on validation pairs, with a verdict, and
leave the package as it is.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from pathlib import Path

from fewview import weights

SCRIPTS = Path(__file__).resolve().parent
NETWORKS = ("panorama", "layout", "structure", "aligner", "relation")
"""In the order in which they build on each other."""
PHASES = ("networks", "parameters", "joint")


def main() -> None:
    """Parse the arguments, train."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--phase", choices=PHASES, help="one alone; all three when not given")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--out", type=Path, default=Path("results/training"))
    options = parser.parse_args()
    settings = [part for value in options.set for part in ("--set", value)]
    for phase in PHASES if options.phase is None else (options.phase,):
        if phase == "networks":
            for name in NETWORKS:
                network(name, options.out / name, settings)
        elif phase == "parameters":
            call(SCRIPTS / "fit_parameters.py", "--out", options.out / "parameters.json")
        else:
            call(SCRIPTS / "fit_joint.py", "--out", options.out / "joint", *settings)


def network(name: str, out: Path, settings: list[str]) -> None:
    """Train one network and put its weights into the package."""
    config = SCRIPTS.parent / "configs" / f"train_{name}.yaml"
    resume = ["--resume"] if (out / "checkpoint.pt").is_file() else []
    call("-m", "fewview", "train", config, "--out", out, *resume, *settings)
    for suffix in ("safetensors", "json"):
        shutil.copy(out / f"{name}.{suffix}", weights.FOLDER)


def call(*arguments: str | Path) -> None:
    """Run Python and stop with its exit status where it fails."""
    done = subprocess.run([sys.executable, *map(str, arguments)], check=False)
    if done.returncode:
        raise SystemExit(done.returncode)


if __name__ == "__main__":
    main()
