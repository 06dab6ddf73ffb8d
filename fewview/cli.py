"""The command line; every command imports what it needs when it runs, so that help is instant."""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from fewview import __version__
from fewview.errors import FewviewError

if TYPE_CHECKING:
    from fewview.config import Config
    from fewview.types import Observer, Reconstruction

ALL_PLACED, DEFECT, BAD_INPUT, PARTIAL, INTERRUPTED = 0, 1, 2, 3, 130
DEMO_ROOM = 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code: 0 all placed, 3 partly, 2 bad input, 1 our defect."""
    options = _parser().parse_args(arguments)
    try:
        return int(options.run(options))
    except FewviewError as error:
        print(f"fewview: {error}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("fewview: interrupted, no result was written", file=sys.stderr)
        return INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="fewview",
        description="Camera poses and a coloured metric mesh from a few RGB-D scans.",
    )
    parser.add_argument("--version", action="version", version=f"fewview {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_reconstruct(commands)
    _add_pair(commands)
    _add_inspect(commands)
    _add_synth(commands)
    _add_demo(commands)
    _add_evaluate(commands)
    _add_view(commands)
    _add_train(commands)
    return parser


_Commands = argparse._SubParsersAction


def _add_reconstruct(commands: _Commands) -> None:  # type: ignore[type-arg]
    command = commands.add_parser("reconstruct", help="poses, mesh and recording of a scan folder")
    command.add_argument("scans", type=Path, metavar="SCANS", help="folder of RGB-D scans")
    command.add_argument("--out", type=Path, required=True, metavar="mesh.ply")
    command.add_argument("--rrd", type=Path, metavar="FILE", help="recording, default beside mesh")
    command.add_argument("--no-rrd", action="store_true", help="write no recording")
    command.add_argument("--view", action="store_true", help="watch the run in the Rerun viewer")
    command.add_argument("--report", type=Path, metavar="FILE", help="default beside the mesh")
    command.add_argument("--jobs", type=_positive, metavar="N", help="threads, default all cores")
    command.add_argument("--priors", type=Path, metavar="FILE", help="known ups, poses, relations")
    store = command.add_mutually_exclusive_group()
    store.add_argument(
        "--store", type=Path, metavar="DIR", help="scans and pairs kept between runs, NAME.store"
    )
    store.add_argument("--no-store", action="store_true", help="keep nothing between runs")
    _add_settings(command)
    command.set_defaults(run=_reconstruct)


def _add_pair(commands: _Commands) -> None:  # type: ignore[type-arg]
    command = commands.add_parser("pair", help="top-K relative poses of two scans")
    command.add_argument("scans", type=Path, metavar="SCANS")
    command.add_argument("a", metavar="A", help="name of the source scan")
    command.add_argument("b", metavar="B", help="name of the target scan")
    command.add_argument("--json", action="store_true", help="print JSON")
    _add_settings(command)
    command.set_defaults(run=_pair)


def _add_inspect(commands: _Commands) -> None:  # type: ignore[type-arg]
    command = commands.add_parser("inspect", help="what is recognised in a folder; runs nothing")
    command.add_argument("scans", type=Path, metavar="SCANS")
    command.set_defaults(run=_inspect)


def _add_synth(commands: _Commands) -> None:  # type: ignore[type-arg]
    command = commands.add_parser("synth", help="generated rooms as scans with ground truth")
    command.add_argument("out", type=Path, metavar="OUT")
    command.add_argument("--rooms", type=_positive, default=1, metavar="N")
    command.add_argument("--scans", type=_positive, default=8, metavar="M")
    command.add_argument("--seed", type=_natural, default=0, metavar="S")
    command.set_defaults(run=_synth)


def _add_demo(commands: _Commands) -> None:  # type: ignore[type-arg]
    command = commands.add_parser("demo", help="generate a room, reconstruct it, compare")
    command.add_argument("--out", type=Path, default=Path("demo"), metavar="DIR")
    command.set_defaults(run=_demo)


def _add_evaluate(commands: _Commands) -> None:  # type: ignore[type-arg]
    command = commands.add_parser("evaluate", help="errors of a report against ground truth")
    command.add_argument("scans", type=Path, metavar="SCANS")
    command.add_argument("report", type=Path, metavar="REPORT")
    command.set_defaults(run=_evaluate)


def _add_view(commands: _Commands) -> None:  # type: ignore[type-arg]
    command = commands.add_parser("view", help="open a recording in the Rerun viewer")
    command.add_argument("file", type=Path, metavar="FILE.rrd")
    command.set_defaults(run=_view)


def _add_train(commands: _Commands) -> None:  # type: ignore[type-arg]
    command = commands.add_parser("train", help="train a completion network on generated rooms")
    command.add_argument("config", type=Path, metavar="CONFIG", help="configs/train_NAME.yaml")
    command.add_argument("--out", type=Path, metavar="DIR", help="default results/CONFIG")
    command.add_argument("--resume", action="store_true", help="go on from the checkpoint in DIR")
    command.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto")
    command.add_argument("--jobs", type=_natural, metavar="N", help="processes that make rooms")
    command.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    command.set_defaults(run=_train)


def _add_settings(command: argparse.ArgumentParser) -> None:
    command.add_argument("--top-k", type=_positive, metavar="K", help="candidates kept per pair")
    command.add_argument("--preset", default="default", metavar="default|fast|accurate")
    command.add_argument("--config", type=Path, metavar="FILE", help="YAML settings")
    command.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    command.add_argument("--seed", type=_natural, default=0)


def _config(options: argparse.Namespace) -> Config:
    from fewview import config

    chosen = tuple(options.set)
    if options.top_k is not None:
        chosen += (f"matching.top_k={options.top_k}",)
    return config.load(options.preset, options.config, chosen)


def _reconstruct(options: argparse.Namespace) -> int:
    config = _config(options)
    recording = None if options.no_rrd else options.rrd or options.out.with_suffix(".rrd")
    _check_target(options.out, ".ply")
    for path in (recording, options.report):
        if path is not None:
            _check_target(path)
    store = None if options.no_store else options.store or options.out.with_suffix(".store")
    result = _run(
        options.scans,
        options.out,
        config,
        options.seed,
        options.jobs,
        recording,
        options.view,
        options.report,
        options.priors,
        store,
    )
    complete = all(p.component == 0 for p in result.solution.placements)
    return ALL_PLACED if complete else PARTIAL


def _run(
    scans: Path,
    out: Path,
    config: Config,
    seed: int,
    jobs: int | None,
    recording: Path | None,
    view: bool,
    report: Path | None,
    priors: Path | None = None,
    store: Path | None = None,
) -> Reconstruction:
    """Reconstruct with progress and recording, then save everything."""
    from fewview import pipeline
    from fewview import priors as known
    from fewview import report as reports
    from fewview import scans as readers
    from fewview.progress import Progress
    from fewview.store import Store

    kept = None if store is None else Store(store)
    found = readers.load(scans)
    names = [scan.name for scan in found.scans]
    told = None if priors is None else known.load(priors, names, config.matching.top_k)
    observers: list[Observer] = [Progress()]
    with ExitStack() as stack:
        if recording is not None or view:
            from fewview.recording import Recorder

            observers.append(stack.enter_context(Recorder(recording, view)))
        result = pipeline.reconstruct(found, config, seed, jobs, observers, told, kept)
        reports.save(result, out, report)
    return result


def _pair(options: argparse.Namespace) -> int:
    from fewview import pipeline
    from fewview import scans as readers
    from fewview.report import pair_dict
    from fewview.types import PairStatus

    config = _config(options)
    result = pipeline.match_two(
        readers.load(options.scans), options.a, options.b, config, options.seed
    )
    values = pair_dict(result, (options.a, options.b), None)
    if options.json:
        print(json.dumps(values, indent=1, allow_nan=False))
    else:
        print(f"{options.a} -> {options.b}: {result.status} {result.reason or ''}".rstrip())
        for candidate in values["candidates"]:
            print(_candidate_text(candidate))
    return ALL_PLACED if result.status is PairStatus.OK else PARTIAL


def _candidate_text(candidate: dict[str, object]) -> str:
    pose = candidate["target_T_source"]
    assert isinstance(pose, list)
    rows = "\n".join("    " + " ".join(f"{v:10.5f}" for v in row) for row in pose)
    support = candidate["support"]
    assert isinstance(support, dict)
    counts = ", ".join(f"{k} {v}" for k, v in support.items() if v)
    return (
        f"  {candidate['rank']}: probability {candidate['probability']:.2f}, "
        f"overlap {candidate['overlap']:.2f}, {counts or 'no matches'}\n{rows}"
    )


def _inspect(options: argparse.Namespace) -> int:
    from fewview import scans as readers

    print(readers.inspect(options.scans).text())
    return ALL_PLACED


def _synth(options: argparse.Namespace) -> int:
    from fewview import synthetic

    for room in range(options.rooms):
        folder = options.out if options.rooms == 1 else options.out / f"room-{room:03d}"
        scene = synthetic.generate(
            synthetic.split_seed("demo", options.seed + room), options.scans, options.seed, "random"
        )
        synthetic.write(folder, scene)
        print(f"{folder}: {options.scans} scans")
    return ALL_PLACED


def _demo(options: argparse.Namespace) -> int:
    from fewview import config, synthetic

    folder, mesh = options.out / "scans", options.out / "mesh.ply"
    scene = synthetic.generate(synthetic.split_seed("demo", DEMO_ROOM), 8, 0, "spread")
    synthetic.write(folder, scene)
    result = _run(folder, mesh, config.load(), 0, None, mesh.with_suffix(".rrd"), False, None, None)
    print(_scores(folder, mesh.with_suffix(".json")))
    print(f"mesh: {mesh}\nrecording: {mesh.with_suffix('.rrd')} (fewview view opens it)")
    complete = all(p.component == 0 for p in result.solution.placements)
    return ALL_PLACED if complete else PARTIAL


def _evaluate(options: argparse.Namespace) -> int:
    print(_scores(options.scans, options.report))
    return ALL_PLACED


def _scores(scans: Path, report: Path) -> str:
    from fewview import evaluation
    from fewview import scans as readers

    try:
        values = json.loads(report.read_text())
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        reason = "cannot be read" if isinstance(error, OSError) else "is not JSON"
        raise FewviewError(f"{report}: {reason}; give a report of fewview reconstruct") from error
    truth = readers.truth(scans)
    if not truth:
        raise FewviewError(f"{scans}: no ground-truth poses beside the scans to compare with")
    return evaluation.text(evaluation.evaluate_report(values, truth))


def _view(options: argparse.Namespace) -> int:
    from fewview.recording import view

    view(options.file)
    return ALL_PLACED


def _train(options: argparse.Namespace) -> int:
    import os

    from fewview.training import loop, settings

    config = settings.load(options.config, tuple(options.set))
    out = options.out or Path("results") / options.config.stem
    jobs = max(1, (os.cpu_count() or 1) - 1) if options.jobs is None else options.jobs
    try:
        best = loop.train(
            config,
            out,
            resume=options.resume,
            device=options.device,
            jobs=jobs,
            report=lambda line: print(line, file=sys.stderr, flush=True),
        )
    except KeyboardInterrupt:
        print(f"fewview: stopped; --resume goes on from {out}", file=sys.stderr)
        return INTERRUPTED
    finally:
        _record_curves(out / loop.CURVES)
    print(f"weights: {best}")
    return ALL_PLACED


def _record_curves(curves: Path) -> None:
    """Beside the JSON as a recording, where Rerun is installed: training does without it."""
    if curves.is_file() and importlib.util.find_spec("rerun") is not None:
        from fewview.recording import record_curves

        record_curves(json.loads(curves.read_text()), curves.with_suffix(".rrd"))


def _check_target(path: Path, suffix: str | None = None) -> None:
    """Refuse at once what could not be written an hour later."""
    if suffix is not None and path.suffix.lower() != suffix:
        raise FewviewError(f"{path}: the mesh is written as {suffix}; name it so")
    if path.is_dir():
        raise FewviewError(f"{path}: is a folder; name a file in it")
    if not path.parent.is_dir():
        raise FewviewError(f"{path.parent}: no such folder; make it first")


def _positive(text: str) -> int:
    return _at_least(text, 1)


def _natural(text: str) -> int:
    return _at_least(text, 0)


def _at_least(text: str, least: int) -> int:
    try:
        value = int(text)
    except ValueError:
        value = least - 1
    if value < least:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number from {least} up")
    return value


if __name__ == "__main__":
    sys.exit(main())
