"""Fit the potential of two scans that stand in one room, and store it in the package.

    python scripts/fit_potential.py --rooms 44 --scene FOLDER ... --check FOLDER ...

Pseudo-likelihood: in generated rooms of the validation split that played no part in fitting the
candidates' probabilities, in corridors whose halves look alike, and in folders given with --scene,
one or two scans of a set are put beside others that stand right. Rooms and corridors are seen
twice, the second time through a sensor whose calibration is off. Of all places that candidates and
the aligner propose for the scans, one is right or none is; the log odds of a place are the sum of
the potentials of the pairs that it creates. Guests are put beside each set of a room too, for which
no place is right: strangers, scans of the next room, and twins, scans of the room that is the
mirror image of this one.
The report is of scenes in turn held out by quarters, and of folders given with --check, which are
never fitted to; what is stored is fitted to all others. What the aligner says of scans drawn as one
is weighed afterwards, on further rooms that the potentials do not know; with --drawn-alone the
potentials stay as they are stored.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

from fewview import weights
from fewview.config import Config
from fewview.together import PotentialModel, potential_from
from potential.fit import HIDDEN, HIDDEN_RIDGE, RIDGE, fitted, with_drawings
from potential.report import Json, held_out, told
from potential.samples import RIGHT_DEG, RIGHT_M, Sample, cached
from potential.scenes import Matched, corridor, folder, room
from validation_views import WARPED

FIRST_ROOM = 64
"""Of the validation split; those before it made the candidates' probabilities."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rooms", type=int, default=44)
    parser.add_argument("--corridors", type=int, default=40)
    parser.add_argument("--drawn-rooms", type=int, default=16)
    parser.add_argument("--drawn-alone", action="store_true")
    parser.add_argument("--scene", type=Path, nargs="*", default=[])
    parser.add_argument("--check", type=Path, nargs="*", default=[])
    parser.add_argument("--cache", type=Path, default=Path("results/potential"))
    parser.add_argument("--out", type=Path, default=weights.FOLDER / "potential.json")
    options = parser.parse_args()
    options.cache.mkdir(parents=True, exist_ok=True)
    if options.drawn_alone:
        values = json.loads(options.out.read_text())
        model, made = potential_from(values), values["made"]
        report = made["report"]
    else:
        model, report = potentials(options)
        made = recipe(options)
    first = made["rooms"][1]
    apart = seen_twice(options.cache, "room", room, range(first, first + options.drawn_rooms))
    report["apart"] = told([(replace(model, drawn=0.0), s) for s in apart])
    model = with_drawings(model, apart)
    report["apart, with drawings"] = told([(model, s) for s in apart])
    made |= {"drawn_rooms": [first, first + options.drawn_rooms], "report": report}
    print(json.dumps(report, indent=1))
    options.out.write_text(json.dumps(stored(model, made), indent=1) + "\n")


def potentials(options: argparse.Namespace) -> tuple[PotentialModel, Json]:
    """The potentials without drawings, and what is reported of them."""
    rooms = range(FIRST_ROOM, FIRST_ROOM + options.rooms)
    fit = seen_twice(options.cache, "room", room, rooms)
    fit += seen_twice(options.cache, "corridor", corridor, range(options.corridors))
    fit += [s for f in options.scene for s in cached(options.cache, f.name, partial(folder, f))]
    check = [s for f in options.check for s in cached(options.cache, f.name, partial(folder, f))]
    model, report = fitted(fit), {"held out": held_out(fit)}
    for scene in dict.fromkeys(s.scene for s in check):
        report[scene] = told([(model, s) for s in check if s.scene == scene])
    return model, report


def seen_twice(
    cache: Path, kind: str, make: Callable[[int, bool], Matched], indices: range
) -> list[Sample]:
    """The samples of rooms or corridors through either sensor."""
    found = []
    for i, warped in product(indices, (False, True)):
        found += cached(cache, f"{kind}-{i:03d}{WARPED * warped}", partial(make, i, warped))
    return found


def recipe(options: argparse.Namespace) -> Json:
    """How the potentials were made."""
    return {
        "by": "scripts/fit_potential.py",
        "model": f"sum over pairs, {HIDDEN} inner units, ridges {RIDGE} and {HIDDEN_RIDGE}",
        "right_within": {"deg": RIGHT_DEG, "m": RIGHT_M},
        "rooms": [FIRST_ROOM, FIRST_ROOM + options.rooms],
        "corridors": options.corridors,
        "scenes": [f.name for f in options.scene],
        "checked_on": [f.name for f in options.check],
        "config_hash": Config().hash(),
    }


def stored(model: PotentialModel, made: Json) -> Json:
    pair = model.pair
    arrays = ("mean", "scale", "coefficients", "inner", "inner_offsets", "outer")
    return {
        "features": list(pair.features),
        **{name: getattr(pair, name).round(6).tolist() for name in arrays},
        "intercept": round(pair.intercept, 6),
        **{name: round(getattr(model, name), 6) for name in ("join", "drawn", "typical")},
        "made": made,
    }


if __name__ == "__main__":
    main()
